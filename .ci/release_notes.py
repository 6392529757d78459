#!/usr/bin/env python3
# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Prints what CHANGELOG.md says about the release of a tag.

    .ci/release_notes.py v0.1.0

It fails if the tag is not "v" and the version in pyproject.toml, if CITATION.cff names another
version or date than CHANGELOG.md, or if CHANGELOG.md says nothing about the version.
"""

import re
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).parent.parent


def notes(tag: str) -> str:
    """The section of CHANGELOG.md about a tag, without its title."""
    version = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    if tag != f"v{version}":
        sys.exit(f"the tag {tag} is not v{version}, the version in pyproject.toml")
    sections = re.split(r"^## ", (ROOT / "CHANGELOG.md").read_text(), flags=re.MULTILINE)
    own = [section for section in sections if section.startswith(f"[{version}] - ")]
    title, _, text = own[0].partition("\n") if own else ("", "", "")
    if not text.strip():
        sys.exit(f'CHANGELOG.md has no section "## [{version}] - DATE", or an empty one')
    date = title.partition(" - ")[2]
    for line in (f"version: {version}", f"date-released: {date}"):
        if line not in (ROOT / "CITATION.cff").read_text().splitlines():
            sys.exit(f'CITATION.cff has no line "{line}"')
    return text.strip()


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("type .ci/release_notes.py TAG, such as .ci/release_notes.py v0.1.0")
    print(notes(sys.argv[1]))

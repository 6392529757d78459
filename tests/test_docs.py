# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""The documentation names what there is."""

import re
from pathlib import Path

import newton
import pytest

from newton_avbd.study.stability.cases import CASES

ROOT = Path(__file__).parent.parent
PACKAGE = ROOT / "newton_avbd"
FRONT_PAGES = ("README.md", "CONTRIBUTING.md", "CHANGELOG.md", "SECURITY.md")
"""Outside of the site, whose build checks the links of its own pages."""
STEP = (ROOT / "docs" / "algorithm.md").read_text().split("| what | function | file |")[1]
STAGES = [line for line in STEP.split("\n\n")[0].splitlines() if ".py" in line]
ABOUT_CODE = ("algorithm", "mechanisms")
"""Pages whose names in backticks are those of this package, its hard cases and of Newton."""
SOURCE = "\n".join(path.read_text() for path in sorted(PACKAGE.rglob("*.py")))


@pytest.mark.parametrize("line", STAGES)
def test_the_functions_of_the_step_are_where_the_docs_say(line: str) -> None:
    _, _, functions, files, _ = line.split("|")
    sources = [(PACKAGE / file).read_text() for file in re.findall(r"`(.+?)`", files)]
    sources += [path.read_text() for path in (PACKAGE / "drivers").glob("world*.py")]
    for function in re.findall(r"`(.+?)`", functions):
        assert any(f"def {function}(" in source for source in sources), function


@pytest.mark.parametrize("page", sorted((ROOT / "docs").rglob("*.md")), ids=lambda page: page.stem)
def test_the_files_that_a_page_names_exist(page: Path) -> None:
    for name in re.findall(r"`([a-z0-9_/]+\.py)`", page.read_text()):
        places = (ROOT / name, PACKAGE / name, PACKAGE / "step" / name, PACKAGE / "rows" / name)
        assert any(place.exists() for place in places), name


@pytest.mark.parametrize("page", ABOUT_CODE)
def test_the_names_that_a_page_says_of_the_code_are_in_it(page: str) -> None:
    known = set(re.findall(r"\w+", SOURCE)) | set(dir(newton.Control())) | set(CASES)
    text = (ROOT / "docs" / f"{page}.md").read_text()
    names = re.findall(r"`([A-Za-z_][\w.]*)(?:=[^`]*)?`", text)
    assert len(names) > 50
    assert not [name for name in names if name.split(".")[-1] not in known]
    for name, file in re.findall(r"`(\w+)`\s+in\s+`([\w/]+\.py)`", text):
        assert re.search(rf"\b{name}\b", (PACKAGE / file).read_text()), f"{name} in {file}"


@pytest.mark.parametrize("page", ABOUT_CODE)
def test_the_constants_that_a_page_gives_a_value_have_it(page: str) -> None:
    text = (ROOT / "docs" / f"{page}.md").read_text()
    for name, value in re.findall(r"`([A-Z_]+)` = ([-.e\d]+\d)", text):
        defined = re.findall(rf"^{name} = .*?([\d.]+(?:e-?\d+)?)\)*$", SOURCE, re.MULTILINE)
        assert float(value) in map(float, defined), name


def anchors(page: Path) -> set[str]:
    """What a link may name behind # in a page: its titles, as GitHub and the site spell them."""
    titles = re.findall(r"^#+ (.+)$", page.read_text(), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}


@pytest.mark.parametrize("page", FRONT_PAGES)
def test_the_links_of_a_front_page_lead_somewhere(page: str) -> None:
    for link in re.findall(r"\]\((?!http)([^)]+)", (ROOT / page).read_text()):
        file, _, anchor = link.partition("#")
        assert (ROOT / file).exists(), link
        assert not anchor or anchor in anchors(ROOT / file), link

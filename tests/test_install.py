# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""What an install brings: versions that go together."""

import importlib.metadata
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.version import Version

ROOT = Path(__file__).parent.parent


def mujoco_of(requirements: list[str]) -> dict[str, Requirement]:
    """Requirements of MuJoCo and MuJoCo Warp, by name."""
    found = [Requirement(text) for text in requirements]
    return {item.name: item for item in found if item.name in ("mujoco", "mujoco-warp")}


def test_mujoco_is_pinned_as_newton_pins_it() -> None:
    """The extra ``scenes`` allows what newton[sim] allows, and with it no MuJoCo 4."""
    newton_sim = mujoco_of(
        [text for text in importlib.metadata.requires("newton") if "extra == 'sim'" in text]
    )
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    scenes = mujoco_of(project["optional-dependencies"]["scenes"])
    assert scenes.keys() == {"mujoco", "mujoco-warp"}
    for name, pin in scenes.items():
        assert pin.specifier == newton_sim[name].specifier
        assert not pin.specifier.contains("4.0.0")
        assert pin.specifier.contains(importlib.metadata.version(name))


def of_the_forge(path: str) -> str:
    """A file below .github, which a source distribution leaves out."""
    file = ROOT / ".github" / path
    if not file.exists():
        pytest.skip("a source distribution has no configuration of the forge")
    return file.read_text()


def test_ci_tests_the_lowest_versions_that_an_install_may_bring() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    pins = dict(re.findall(r"([\w-]+)==([\d.]+)", of_the_forge("workflows/ci.yml")))
    for requirement in map(Requirement, project["dependencies"]):
        (lowest,) = [bound.version for bound in requirement.specifier if bound.operator == ">="]
        assert Version(pins[requirement.name]) == Version(lowest)


def test_newton_is_bounded_by_the_next_minor_version() -> None:
    """Newton breaks names between minor versions, and nobody has tried the next one."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    needed = {item.name: item for item in map(Requirement, project["dependencies"])}["newton"]
    installed = Version(importlib.metadata.version("newton"))
    assert needed.specifier.contains(installed)
    assert not needed.specifier.contains(f"{installed.major}.{installed.minor + 1}.0")


def test_the_form_for_a_fault_asks_for_what_mending_it_needs() -> None:
    form = of_the_forge("ISSUE_TEMPLATE/fault.yml")
    assert {"what", "scene", "versions", "device", "report"} <= set(re.findall(r"id: (\w+)", form))


def release_notes(root: Path, tag: str) -> subprocess.CompletedProcess[str]:
    """What CI asks about a tag before it releases."""
    command = [sys.executable, root / ".ci" / "release_notes.py", tag]
    return subprocess.run(command, capture_output=True, text=True)


def test_the_last_release_has_one_version_and_one_date_everywhere() -> None:
    """The project's version is that of the newest section of CHANGELOG, or in work on the next."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    changelog = (ROOT / "CHANGELOG.md").read_text()
    released, date = re.findall(r"^## \[(\d.*)\] - (.+)$", changelog, re.MULTILINE)[0]
    citation = (ROOT / "CITATION.cff").read_text().splitlines()
    assert {f"version: {released}", f"date-released: {date}"} <= set(citation)
    version = Version(project["version"])
    assert version == Version(released) or (version.is_devrelease and version > Version(released))


@pytest.fixture
def project(tmp_path: Path) -> Path:
    """A project that may be released as v1.2.0."""
    (tmp_path / ".ci").mkdir()
    script = (ROOT / ".ci" / "release_notes.py").read_text()
    (tmp_path / ".ci" / "release_notes.py").write_text(script)
    (tmp_path / "pyproject.toml").write_text('[project]\nversion = "1.2.0"\n')
    (tmp_path / "CITATION.cff").write_text("version: 1.2.0\ndate-released: 2027-01-31\n")
    (tmp_path / "CHANGELOG.md").write_text(
        "# Changelog\n\n## [Unreleased]\n\n- Add x.\n\n"
        "## [1.2.0] - 2027-01-31\n\n### Added\n\n- Add y.\n\n"
        "## [1.1.0] - 2026-12-31\n\n- Add z.\n"
    )
    return tmp_path


def test_a_release_says_what_its_own_section_of_the_changelog_says(project: Path) -> None:
    result = release_notes(project, "v1.2.0")
    assert (result.returncode, result.stdout) == (0, "### Added\n\n- Add y.\n")


@pytest.mark.parametrize(
    ("file", "old", "new", "answer"),
    [
        ("pyproject.toml", "1.2.0", "1.2.1.dev0", "the tag v1.2.0 is not v1.2.1.dev0"),
        ("CHANGELOG.md", "[1.2.0]", "[1.3.0]", 'no section "## [1.2.0] - DATE"'),
        ("CHANGELOG.md", "### Added\n\n- Add y.\n", "", "or an empty one"),
        ("CITATION.cff", "1.2.0", "1.1.0", 'no line "version: 1.2.0"'),
        ("CITATION.cff", "2027", "2026", 'no line "date-released: 2027-01-31"'),
    ],
)
def test_a_release_is_refused_where_its_files_disagree(
    project: Path, file: str, old: str, new: str, answer: str
) -> None:
    text = (project / file).read_text()
    (project / file).write_text(text.replace(old, new))
    result = release_notes(project, "v1.2.0")
    assert result.returncode == 1 and answer in result.stderr

# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""How modules may depend on each other."""

import ast
import os
import re
import subprocess
import sys
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import newton_avbd

PACKAGE = Path(newton_avbd.__file__).parent
CONTRIBUTING = Path(__file__).parent.parent / "CONTRIBUTING.md"
MODULES = {
    ".".join(path.relative_to(PACKAGE.parent).with_suffix("").parts).removesuffix(".__init__"): path
    for path in PACKAGE.rglob("*.py")
}


def imported(module: str) -> set[str]:
    """Modules of the package that a module imports anywhere, within functions, too."""
    path = MODULES[module]
    parents = module.split(".") if path.name == "__init__.py" else module.split(".")[:-1]
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            above = parents[: len(parents) + 1 - node.level] if node.level else []
            base = ".".join([*above, *([node.module] if node.module else [])])
            names = {f"{base}.{alias.name}" for alias in node.names}
            found |= names & MODULES.keys() or {base}
    return found & MODULES.keys() - {module}


def test_no_module_imports_itself_by_way_of_others() -> None:
    """Not by an import within a function either: what it needs lives where both may see it."""
    sorter = TopologicalSorter({module: imported(module) for module in MODULES})
    try:
        sorter.prepare()
    except CycleError as error:
        raise AssertionError(" -> ".join(error.args[1])) from None
    assert imported("newton_avbd.solver") >= {"newton_avbd.effects", "newton_avbd.report"}


def layers() -> list[list[str]]:
    """Modules and folders of the package in the order of its table in ``CONTRIBUTING.md``."""
    table = CONTRIBUTING.read_text().split("| in `newton_avbd/` | what is in it |")[1]
    rows = [line.split("|")[1] for line in table.split("\n\n")[0].splitlines()[2:]]
    return [re.findall(r"`(\w+)(?:/|\.py)`", row) for row in rows]


def part(module: str) -> str:
    """The module or folder right below the package that holds a module."""
    return (*module.split("."), "__init__")[1]


def test_the_table_of_the_package_lists_what_there_is() -> None:
    listed = [name for layer in layers() for name in layer]
    assert sorted(listed) == sorted({part(module) for module in MODULES})


def test_imports_go_down_the_table_of_the_package() -> None:
    """So device code knows no files and no studies, and a law knows no stage that uses it."""
    depth = {name: i for i, layer in enumerate(layers()) for name in layer}
    assert depth["commands"] < depth["solver"] < depth["drivers"] < depth["step"] < depth["rows"]
    upwards = [
        f"{module} -> {other}"
        for module in sorted(MODULES)
        for other in sorted(imported(module))
        if depth[part(other)] < depth[part(module)]
    ]
    assert not upwards


def test_no_subject_of_a_study_needs_itself_by_way_of_others() -> None:
    """What several share is in one of them or beside them, and not in two."""
    below = [module for module in MODULES if module.startswith("newton_avbd.study.")]
    needs: dict[str, set[str]] = {}
    for module in below:
        own = module.split(".")[2]
        others = {other.split(".")[2] for other in imported(module) & set(below)}
        needs.setdefault(own, set()).update(others - {own})
    TopologicalSorter(needs).prepare()


def test_public_names_are_listed_before_they_are_imported() -> None:
    program = (
        "import sys, newton_avbd as package\n"
        "assert set(package.__all__) <= set(dir(package)) and 'newton' not in sys.modules\n"
        "assert not hasattr(package, 'Solver')\n"
        "assert package.settings.SCENE_SETTINGS and package.coupling.RigidCoupling\n"
        "from newton_avbd import *\n"
        "assert SolverAVBD is package.SolverAVBD is package.solver.SolverAVBD\n"
        "assert all(hasattr(package, name) for name in package.__all__)"
    )
    # without what the tests set up in every process
    environment = {**os.environ, "PYTHONPATH": str(PACKAGE.parent)}
    subprocess.run([sys.executable, "-c", program], check=True, env=environment)


LONG = {
    "push_axis": 13,
    "leave_link": 10,
    "axis_work": 10,
    "linear_force": 10,
    "law_of": 10,
    "bend_sum": 9,
    "add_axis": 9,
    "add_joint": 9,
    "sweep_blocks": 9,
}
"""Device functions that take more than eight values, and how many; the list may only shrink."""


def test_device_functions_take_few_arguments() -> None:
    """What lasts comes as ``Solver``, what a step was given as ``Step``."""
    counts = {}
    for folder in ("algebra", "blocks", "rows", "step", "drivers"):
        for path in (PACKAGE / folder).glob("*.py"):
            for node in ast.walk(ast.parse(path.read_text())):
                if isinstance(node, ast.FunctionDef) and any(
                    ast.unparse(decorator).startswith("wp.func")
                    for decorator in node.decorator_list
                ):
                    counts[node.name] = max(counts.get(node.name, 0), len(node.args.args))
    assert len(counts) > 500
    assert {name: count for name, count in counts.items() if count > 8} == LONG


FACTORY_LINES = 250
"""Most lines of a function with others in it."""
FUNCTION_LINES = 120
"""Most lines of a function, its docstring aside."""


def test_functions_are_short() -> None:
    """Device functions are made in factories, which are read as a whole."""
    too_long = []
    for path in sorted(PACKAGE.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            if not isinstance(node, ast.FunctionDef):
                continue
            lines = node.end_lineno - node.lineno + 1
            inner = [f for f in ast.walk(node) if isinstance(f, ast.FunctionDef) and f is not node]
            if not inner:
                lines -= len((ast.get_docstring(node, clean=False) or "").splitlines())
            if lines > (FACTORY_LINES if inner else FUNCTION_LINES):
                too_long.append(f"{path.relative_to(PACKAGE)}: {node.name}, {lines} lines")
    assert not too_long

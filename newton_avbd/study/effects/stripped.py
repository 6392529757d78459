# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""A solver in which the code of absent effects never existed, to compare the real one with.

``strip`` copies the package and resolves every ``if wp.static(...)`` for given effects in its
source, so that what is left is what such a solver would have been written as. Where the
kernels that Warp generates of both are the same, absent effects cost nothing.

Run as ``python -m newton_avbd.study.effects.stripped FOLDER < effects`` it writes the code of the
kernels for pickled effects there.
"""

import ast
import os
import pickle
import re
import subprocess
import sys
import tempfile
from pathlib import Path

import warp as wp
from warp._src.context import ModuleBuilder

import newton_avbd
from newton_avbd import Effects

PACKAGE = Path(newton_avbd.__file__).parent

Code = dict[str, list[str]]
"""Functions as generated, without comments and in names that do not depend on what is absent, by
kernel."""


def real_and_stripped(effects: Effects) -> tuple[Code, Code]:
    """Code of the kernels for some effects as Warp generates it, of both packages."""
    with tempfile.TemporaryDirectory() as folder:
        stripped = Path(folder, "stripped")
        strip(effects, stripped)
        return (
            _generated(effects, PACKAGE.parent, Path(folder, "a")),
            _generated(effects, stripped, Path(folder, "b")),
        )


def strip(effects: Effects, folder: Path) -> int:
    """Write the package without the branches that some effects do not take.

    Returns:
        Number of branches that were resolved.
    """
    known = {
        "effects": effects,
        "linear": effects.kinds.linear,
        "angular": effects.kinds.angular,
        "kinds": effects.kinds,
        "len": len,
        "bool": bool,
    }
    resolved = 0
    for source in PACKAGE.rglob("*.py"):
        target = folder / source.relative_to(PACKAGE.parent)
        target.parent.mkdir(parents=True, exist_ok=True)
        resolver = _Resolver(known)
        tree = resolver.visit(ast.parse(source.read_text()))
        target.write_text(ast.unparse(tree))
        resolved += resolver.count
    return resolved


class _Resolver(ast.NodeTransformer):
    """Replaces ``if wp.static(...)`` by the branch that is taken."""

    def __init__(self, known: dict[str, object]) -> None:
        self._known = known
        self.count = 0

    def visit_If(self, node: ast.If) -> ast.AST | list[ast.stmt]:
        self.generic_visit(node)
        call = node.test
        if not (isinstance(call, ast.Call) and ast.unparse(call.func) == "wp.static"):
            return node
        try:
            is_taken = eval(ast.unparse(call.args[0]), {"__builtins__": {}}, self._known)
        except NameError:
            return node
        self.count += 1
        return (node.body if is_taken else node.orelse) or [ast.Pass()]


def _generated(effects: Effects, path: Path, folder: Path) -> Code:
    """Code of the kernels of the package in ``path``, from a process of its own."""
    folder.mkdir()
    subprocess.run(
        [sys.executable, "-m", "newton_avbd.study.effects.stripped", str(folder)],
        cwd=path,
        env={**os.environ, "PYTHONPATH": str(path)},
        input=pickle.dumps(effects),
        stdout=subprocess.DEVNULL,
        check=True,
    )
    # the files are named by a hash of the Python source
    return {
        re.sub(r"_[0-9a-f]{8}$", "", file.stem): [
            _canonical(function)
            for function in re.sub(r"_[0-9a-f]{8,}", "", file.read_text()).split("// primal vars")
        ]
        for file in folder.glob("*.cpp")
    }


def _canonical(function: str) -> str:
    """The code of a function without comments, which cite lines of the Python source, and without
    the constants that Warp declares for conditions it resolved; variables numbered anew."""
    code = re.sub(r"\s*//.*", "", function)
    for line, name in re.findall(r"(\n\s*const bool (var_\d+) = (?:true|false);)", code):
        if len(re.findall(rf"\b{name}\b", code)) == 1:
            code = code.replace(line, "")
    numbers: dict[str, int] = {}
    code = re.sub(r"var_\d+\b", lambda m: f"var_{numbers.setdefault(m[0], len(numbers))}", code)
    return re.sub(r"\s+", " ", code)


def source(kernel: wp.Kernel) -> str:
    """C++ code of a kernel's module, which Warp has no public way to generate without compiling."""
    options = kernel.module.options | {"output_arch": None, "block_dim": 1}
    return ModuleBuilder(kernel.module, options, target="cpu").codegen("cpu")


def main(folder: Path) -> None:
    """Write the code of the kernels for the effects on standard input."""
    from newton_avbd.drivers.world import make_solve
    from newton_avbd.step.bodies import make_integrate, make_predict
    from newton_avbd.step.observables import make_export_parent_force

    effects: Effects = pickle.load(sys.stdin.buffer)
    for make in (make_predict, make_integrate, make_solve, make_export_parent_force):
        kernel = make(effects)
        (folder / f"{kernel.module.name}.cpp").write_text(source(kernel))


if __name__ == "__main__":
    main(Path(sys.argv[1]))

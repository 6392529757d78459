# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""How the tests, and the processes that they start, compile kernels: fast, for few steps of each.

Without derivatives, which no test takes; and optimised less, so that clang takes two thirds of its
time, and steps up to twice as long. Warp looks through a struct, and all that it holds, for each
variable that has it: here once a module.
"""

from typing import Any

import warp as wp
from warp._src import codegen
from warp._src.context import ModuleBuilder

_collect = ModuleBuilder._collect_native_types


def _collect_once(builder: ModuleBuilder, var_type: Any) -> None:
    """As Warp's function, which does nothing for a struct that it has seen."""
    kind = codegen.strip_reference(var_type)
    if isinstance(kind, codegen.Struct):
        seen = vars(builder).setdefault("_seen_structs", set())
        if kind in seen:
            return
        seen.add(kind)
    _collect(builder, kind)


ModuleBuilder._collect_native_types = _collect_once

wp.config.enable_backward = False
wp.config.cpu_compiler_flags = " ".join(
    [
        "-march=native",
        "-fno-vectorize",
        "-fno-slp-vectorize",
        "-disable-lifetime-markers",
        "-mllvm=-inline-threshold=25",
        "-mllvm=-inline-cold-callsite-threshold=5",
        "-mllvm=-enable-gvn-memdep=0",
        "-mllvm=-regalloc=basic",
    ]
)

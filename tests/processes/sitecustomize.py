# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""How the tests, and the processes that they start, compile kernels: fast, for few steps of each.

Without derivatives, which no test takes; and optimised less, with large functions out of line:
clang takes half of its time, and steps up to twice as long. Without any optimisation, as for tests
that are not marked as long (``conftest.py``), it takes a quarter, and what modules share is
compiled once (``shared_objects.py``). What the package caches, such as kernels, it caches for each
level of optimisation. Functions that are made of the same for different scenes are one, which Warp
hashes and writes once. Warp looks through a struct, and all that it holds, for each variable that
has it: here once a module; and through the overloads of its own functions for each call: here once
for the same types. It copies an array's description for each element that is read: here it does
not.
"""

import functools
import re
from collections import Counter
from collections.abc import Callable
from typing import Any
from weakref import WeakKeyDictionary

import shared_functions  # noqa: F401
import shared_objects  # noqa: F401
import warp as wp
from warp._src import codegen
from warp._src.context import ModuleBuilder, ModuleHasher

_cache = functools.cache
# with Warp's default, threads may not share what is not optimised (``drivers/workers.py``)
wp.config.enable_tiles_in_stack_memory = None
LEVEL = {"optimization_level": 2}
"""Option of the kernels that are made next."""


def _cache_by_level(made: Callable[..., Any]) -> Any:
    """As ``functools.cache``; for what the package makes, of each level by itself."""
    if not made.__module__.startswith("newton_avbd."):
        return _cache(made)
    caches = {level: _cache(made) for level in (0, 2)}

    @functools.wraps(made)
    def call(*args: Any, **settings: Any) -> Any:
        return caches[LEVEL["optimization_level"]](*args, **settings)

    vars(call)["cache_clear"] = lambda: [cached.cache_clear() for cached in caches.values()]
    return call


functools.cache = _cache_by_level

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

_resolve = codegen.Adjoint.resolve_func
_resolved: dict[Any, Any] = {}


def _plain(kind: Any) -> Any:
    """A class, or in a tuple that to which something refers; None for what is neither."""
    if isinstance(kind, type):
        return kind
    if isinstance(kind, codegen.Reference) and isinstance(kind.value_type, type):
        return (kind.value_type,)
    return None


_hash = ModuleHasher.hash_function
_hashes: Any = WeakKeyDictionary()  # by function of the package, of all that it is made of
_first: dict[Any, Any] = {}  # functions, by what a module is made for and their hash


def _hash_once(hasher: ModuleHasher, func: Any) -> bytes:
    """As Warp's function, once for all modules."""
    if func not in _hashes:
        made = _hash(hasher, func)
        if not func.adj.func.__module__.startswith("newton_avbd."):
            return made
        _hashes[func] = made
    return _hashes[func]


ModuleHasher.hash_function = _hash_once


_references = codegen.Adjoint.get_references
_referred: Any = WeakKeyDictionary()  # by what was read: constants, types and functions


def _references_once(adjoint: Any) -> Any:
    """As Warp's function, which does nothing else with what it finds."""
    if adjoint not in _referred:
        _referred[adjoint] = _references(adjoint)
    return _referred[adjoint]


codegen.Adjoint.get_references = _references_once


def _first_alike(builder: ModuleBuilder, func: Any) -> Any:
    """What a function of the package is called for: the first one that is made of the same."""
    made = _hashes.get(func)
    if made is None or len(func.user_overloads) != 1 or func.user_templates:
        return func
    return _first.setdefault((_built_for(builder), made), func)


def _resolve_once(
    adjoint: Any, func: Any, arg_types: Any, kwarg_types: Any, min_outputs: Any
) -> Any:
    """As Warp's function: an overload of one of its own functions depends on the types alone."""
    if not func.is_builtin():
        found = _resolve(adjoint, func, arg_types, kwarg_types, min_outputs)
        return _first_alike(adjoint.builder, found)
    kinds = tuple(map(_plain, arg_types))
    if kwarg_types or None in kinds:
        return _resolve(adjoint, func, arg_types, kwarg_types, min_outputs)
    call = func, kinds, min_outputs
    if call not in _resolved:
        _resolved[call] = _resolve(adjoint, func, arg_types, kwarg_types, min_outputs)
    return _resolved[call]


codegen.Adjoint.resolve_func = _resolve_once

_build = ModuleBuilder.build_function
_built: Any = WeakKeyDictionary()  # by function: options, structs and native types
_sources: Any = WeakKeyDictionary()  # by what is built of a function: by device and name


def _built_for(builder: ModuleBuilder) -> tuple[str, str]:
    """What decides how functions are built."""
    return vars(builder).setdefault("_built_for", (builder.target, str(builder.options)))


def _build_once(builder: ModuleBuilder, func: Any) -> None:
    """As Warp's function, once for all modules with the same options that call a function."""
    if func in builder.functions:
        return
    options = _built_for(builder)
    seen = builder.structs, builder.native_types
    if func not in _built or _built[func][0] != options:
        builder.structs, builder.native_types = {}, {}
        vars(builder).pop("_seen_structs", None)
        _build(builder, func)
        _built[func] = options, (builder.structs, builder.native_types)
        _sources.pop(func.adj, None)
        builder.structs, builder.native_types = seen
    for callee in func.adj.called_user_functions:
        _build_once(builder, callee)
    for found, of_func in zip(seen, _built[func][1], strict=True):
        found.update(of_func)
    builder.functions[func] = None


ModuleBuilder.build_function = _build_once

_of_function, _of_struct = codegen.codegen_func, codegen.codegen_struct
_SMALL = 60  # assignments of a function that may be inlined
_ASSIGNED = re.compile(r"^ +var_", re.M)
_VARIABLE = re.compile(r"\bvar_\d+\b")
_LOADED_ARRAY = re.compile(
    r" +(var_\d+) = wp::load\((var_\d+)\);\n( +(?:var_\d+ = wp::address|wp::array_store)\()\1,"
)
_ARRAY = re.compile(r" +wp::array_t<[^;\n]*> (var_\d+);\n")
_LOADED = re.compile(r"wp::load\((var_\d+)\)")
_SUM_OF_STRUCT = re.compile(r"^CUDA_CALLABLE (?=\w+ add\()", re.M)
_ADJOINT_OF_STRUCT = re.compile(r"^(?:static )?CUDA_CALLABLE void adj_[^{;]*\{[^}]*\}", re.M)


def _without_copies(source: str) -> str:
    """The source of a function with arrays read where they are, not by a copy for each element."""
    times = Counter(_VARIABLE.findall(source))
    copies = set()

    def in_place(match: re.Match[str]) -> str:
        copy, array, call = match.groups()
        if times[copy] != 3:  # its declaration, this load and this use
            return match[0]
        copies.add(copy)
        return f"{call}*{array},"

    source = _LOADED_ARRAY.sub(in_place, source)
    source = _ARRAY.sub(lambda match: "" if match[1] in copies else match[0], source)
    return _LOADED.sub(r"(*\1)", source)


def _forward(adjoint: Any, **settings: Any) -> str:
    """As Warp's function; for a CPU out of line if large, without copies.

    Small functions stay in line: products and sums are fused as in the kernels of users there.
    """
    source = _of_function(adjoint, **settings | {"forward_only": True})
    if settings["device"] != "cpu":
        return source
    if settings["inline_hint"] is None and len(_ASSIGNED.findall(source)) > _SMALL:
        source = source.replace("static ", "static WP_NOINLINE ", 1)
    return _without_copies(source)


def _function(adjoint: Any, **settings: Any) -> str:
    """As Warp's function, without the adjoint; once for all modules that call it."""
    if settings["reverse_only"]:
        return ""
    sources = _sources.setdefault(adjoint, {})
    name = settings["device"], settings["c_func_name"]
    if name not in sources:
        sources[name] = _forward(adjoint, **settings)
    return sources[name]


def _struct(*args: Any, **settings: Any) -> str:
    """As Warp's function, without the adjoints; the sum only if it is called."""
    source = _ADJOINT_OF_STRUCT.sub("", _of_struct(*args, **settings))
    return _SUM_OF_STRUCT.sub("inline CUDA_CALLABLE ", source)


codegen.codegen_func, codegen.codegen_struct = _function, _struct

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
    ]
)

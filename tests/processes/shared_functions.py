# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Makes a device function once for all scenes that use the same of it.

The package makes device functions for what a scene calls for: the same code with other values
around it. Warp goes through the code of each, hashes it and writes it in C++. Scenes that differ in
an effect share most functions, if a function counts as the same where all that its code names is.
"""

import ast
import inspect
import sys
import textwrap
from collections.abc import Callable, Hashable
from types import GenericAlias
from typing import Any

import warp as wp
from warp._src.types import Reference

SHARED = ("newton_avbd.", "newton._src.geometry.")
"""Whose functions are shared."""

_TYPES = (type, type(wp.array[float]), Reference, GenericAlias)
_SIMPLE = (int, float, str, bool, type(None), wp.Function, *_TYPES)

_func = wp.func
_made: dict[Hashable, Any] = {}
_paths: dict[Any, dict[str, set[tuple[str, ...]]]] = {}


class _Same:
    """Something that equals itself alone, as a part of a key."""

    def __init__(self, value: Any) -> None:
        self.value = value

    def __hash__(self) -> int:
        return id(self.value)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Same) and other.value is self.value


def _as_key(value: Any) -> Hashable:
    """Equal for what a function may not tell apart."""
    if isinstance(value, tuple):
        return (tuple, *map(_as_key, value))
    if isinstance(value, _SIMPLE):
        return type(value), value
    return _Same(value)


def _named(function: Callable[..., Any]) -> dict[str, set[tuple[str, ...]]]:
    """By free variable of a function: the attributes of it that the code names, as paths."""
    code = function.__code__
    if code not in _paths:
        found: dict[str, set[tuple[str, ...]]] = {name: set() for name in code.co_freevars}

        def look(node: ast.AST) -> None:
            path: list[str] = []
            inner = node
            while isinstance(inner, ast.Attribute):
                path.insert(0, inner.attr)
                inner = inner.value
            if isinstance(inner, ast.Name) and inner.id in found:
                found[inner.id].add(tuple(path))
                return
            for child in ast.iter_child_nodes(node):
                look(child)

        look(ast.parse(textwrap.dedent(inspect.getsource(function))))
        _paths[code] = found
    return _paths[code]


def _key(function: Callable[..., Any], settings: dict[str, Any]) -> Hashable | None:
    """What a function is made of; None if that is not known yet."""
    parts: list[Hashable] = [function.__module__, function.__qualname__, function.__code__]
    parts += [(name, _as_key(value)) for name, value in settings.items()]
    parts += [(name, _as_key(kind)) for name, kind in function.__annotations__.items()]
    parts += [_as_key(function.__defaults__)]
    cells = dict(zip(function.__code__.co_freevars, function.__closure__ or (), strict=True))
    for name, paths in _named(function).items():
        try:
            whole = cells[name].cell_contents
        except ValueError:  # a function that calls itself
            return None
        for path in sorted(paths):
            value = whole
            for attribute in path:
                value = getattr(value, attribute)
            parts.append((name, path, _as_key(value)))
    return tuple(parts)


def _func_once(function: Any = None, **settings: Any) -> Any:
    """As Warp's decorator."""
    scope = sys._getframe(1).f_locals

    def make(function: Callable[..., Any]) -> Any:
        def anew() -> Any:
            # as if called from there: Warp looks for overloads among the variables of its caller
            given = {"_func": _func, "_function": function, "_settings": settings}
            return eval("_func(_function, **_settings)", given, scope)

        is_one_of_many = "<locals>" in function.__qualname__ and function.__name__ not in scope
        if not is_one_of_many or not function.__module__.startswith(SHARED):
            return anew()
        key = _key(function, settings)
        if key is None:
            return anew()
        if key not in _made:
            _made[key] = anew()
        return _made[key]

    return make if function is None else make(function)


wp.func = _func_once

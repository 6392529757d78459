# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Compiles a function that kernels call once, not once for each module that holds it.

Kernels that are not optimised consist of the functions that Warp writes for them, one by one: clang
puts none of them in line, unless it is told to. Scenes that differ in an effect share most of them.
So a module is compiled without the functions that earlier modules have been compiled with, and the
linker takes those from there. The machine code of each is the same as if all were compiled at once.

A function calls others by what it sees of them (``i_...``), so that it is the same whatever they
do; the linker is told for each module which functions (``f_...``) those are.
"""

import hashlib
import os
import re
import shutil
import subprocess
import sys
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import warp as wp

LINKER = shutil.which("ld") if sys.platform == "linux" else None
"""GNU's; without it, modules are compiled as Warp does it."""

_HEAD = re.compile(r"^static ((?:WP_\w+ |CUDA_CALLABLE )*)([^\n(;]*?)\b(\w+)\(\n", re.M)
_END = "\n}\n"
_BETWEEN = re.compile(r"(?:\s|//[^\n]*\n)*\Z")
_CALL = re.compile(r"\b(?<!::)(\w+_\d+)(?=\()")
_KERNELS = re.compile(r"^struct wp_args_", re.M)
_KERNEL = re.compile(r"^(?=(?:static|WP_API) void \w+\()", re.M)
_ENTRY = re.compile(r"^WP_API void (\w+)\(", re.M)


class Function(NamedTuple):
    """What Warp wrote for a function, or for all functions of one name."""

    heads: tuple[str, ...]
    """Type of result, name and arguments, of each."""
    texts: tuple[str, ...]
    """All of it, of each."""
    callees: frozenset[str]
    """Names of what it may call."""
    is_inline: bool
    """Whether it is a part of its callers."""


class Source(NamedTuple):
    """What Warp wrote for a module."""

    start: str
    """Headers and structs."""
    functions: dict[str, Function]
    kernels: str


def parted(source: str) -> Source | None:
    """The parts of a module; None if something in it is not known here."""
    kernels = _KERNELS.search(source)
    heads = list(_HEAD.finditer(source, 0, kernels.start())) if kernels else []
    if not heads:
        return None
    found: dict[str, list[tuple[str, str, bool]]] = {}
    ends = [*(head.start() for head in heads[1:]), kernels.start()]
    for head, next_head in zip(heads, ends, strict=True):
        end = source.find(_END, head.start(), next_head)
        begin = source.find(")\n{\n", head.start(), end + 2)
        rest = end + len(_END)
        if end < 0 or begin < 0 or not _BETWEEN.match(source, rest, next_head):
            return None
        is_inline = "WP_FORCEINLINE" in head[1]
        first = f"{head[2]}{head[3]}(\n{source[head.end() : begin]})"
        found.setdefault(head[3], []).append((first, source[begin + 1 : rest], is_inline))
    functions = {
        name: Function(
            tuple(first for first, _, _ in same),
            tuple(body for _, body, _ in same),
            frozenset(call for _, body, _ in same for call in _CALL.findall(body)) & {*found},
            any(is_inline for _, _, is_inline in same),
        )
        for name, same in found.items()
    }
    return Source(source[: heads[0].start()], functions, source[kernels.start() :])


def _sided(function: Function, name: str) -> str:
    """What callers of a function see of it: its name, without Warp's number, and its types."""
    return "".join(function.heads).replace(f"{name}(", f"{name.rpartition('_')[0]}(")


def named(functions: dict[str, Function], settings: str) -> tuple[dict[str, str], dict[str, str]]:
    """By name: what tells a function from others; and what its callers call it.

    They call it by what they see of it, so that they are the same whatever it does. Only where a
    module has several such functions, and where it is a part of its callers, they call it by what
    it does.
    """
    keys: dict[str, str] = {}
    called: dict[str, str] = {}
    sides = {name: _sided(function, name) for name, function in functions.items()}
    times = Counter(sides.values())

    def key_of(name: str) -> str:
        if name not in keys:
            function = functions[name]
            for callee in function.callees:
                call_of(callee)
            parts = [settings, sides[name], str(function.is_inline)]
            parts += [renamed(text, called) for text in function.texts]
            keys[name] = hashlib.md5("".join(parts).encode()).hexdigest()
        return keys[name]

    def call_of(name: str) -> None:
        if name not in called:
            is_only = times[sides[name]] == 1 and not functions[name].is_inline
            side = hashlib.md5(sides[name].encode()).hexdigest() if is_only else key_of(name)
            called[name] = f"{'i' if is_only else 'f'}_{side}"

    for name in functions:
        key_of(name)
        call_of(name)
    return keys, called


def renamed(text: str, called: dict[str, str]) -> str:
    """Code with other names for what it calls."""
    return _CALL.sub(lambda call: called.get(call[1], call[1]), text)


class Store:
    """Object files with functions, in Warp's cache, which processes share."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        folder.mkdir(parents=True, exist_ok=True)
        self.seen: set[str] = set()
        self.objects: dict[str, str] = {}

    def look(self) -> None:
        """Finds the functions that other processes have added."""
        for entry in os.scandir(self.folder):
            if entry.name.endswith(".keys") and entry.name not in self.seen:
                self.seen.add(entry.name)
                path = entry.path.removesuffix(".keys") + ".o"
                self.objects |= dict.fromkeys(Path(entry.path).read_text().split(), path)

    def add(self, keys: list[str], made: str) -> str:
        """Takes over an object file; returns where it is."""
        name = hashlib.md5("".join(keys).encode()).hexdigest()
        path = self.folder / f"{name}-{os.getpid()}.o"
        os.replace(made, path)
        listed = path.with_suffix(".listed")
        listed.write_text("\n".join(keys))
        os.replace(listed, path.with_suffix(".keys"))
        self.look()
        return str(path)


def written(
    source: Source, keys: dict[str, str], called: dict[str, str], known: set[str]
) -> tuple[str, str]:
    """The source of a module without the functions that are known; and what the linker is told."""
    declared, defined, links = [source.start], [], []
    done = set()
    for name, function in source.functions.items():
        key, own, call = keys[name], f"f_{keys[name]}", called[name]
        if own in done:  # under another name
            continue
        done.add(own)
        for i, (head, text) in enumerate(zip(function.heads, function.texts, strict=True)):
            first = head.replace(f"{name}(", f"{own}(", 1)
            if function.is_inline:
                declared.append(f"static WP_FORCEINLINE {first};\n")
            else:
                weak = f'__attribute__((weak, noinline, section(".ltext.{key}")))'
                declared.append(f'{weak} {first} __asm__("{own}_{i}");\n')
                links.append(f"EXTERN({own}_{i})\n")
                if call != own:
                    as_called = head.replace(f"{name}(", f"{call}(", 1)
                    declared.append(f'{as_called} __asm__("{call}_{i}");\n')
                    links.append(f"{call}_{i} = {own}_{i};\n")
            if name not in known:
                inline = "static WP_FORCEINLINE " if function.is_inline else ""
                defined.append(f"{inline}{first}\n{renamed(text, called)}\n")
    own = hashlib.md5(source.kernels.encode()).hexdigest()
    section = f'__attribute__((section(".ltext.k{own}"))) '
    kernels = _KERNEL.sub(section, renamed(source.kernels, called))
    links += [f"EXTERN({entry})\n" for entry in _ENTRY.findall(source.kernels)]
    return "".join(declared + defined) + kernels, "".join(links)


_build: Callable[..., None] = wp._src.build.build_cpu
_stores: dict[str, Store] = {}


def build(obj_path: str, cpp_path: str, **settings: Any) -> None:
    """As Warp's function."""
    if settings.get("optimization_level") or not LINKER:
        return _build(obj_path, cpp_path, **settings)
    source = parted(Path(cpp_path).read_text(encoding="utf-8"))
    if source is None:
        return _build(obj_path, cpp_path, **settings)
    folder = wp.config.kernel_cache_dir
    store = _stores.setdefault(folder, Store(Path(folder) / "shared_objects"))
    store.look()
    options = {name: value for name, value in settings.items() if name != "pch_dir"}
    before = source.start[: source.start.find("\nstruct ")]
    keys, called = named(source.functions, f"{before}{options}")
    shared = {name for name, function in source.functions.items() if not function.is_inline}
    objects = {name: store.objects[keys[name]] for name in shared if keys[name] in store.objects}
    others = {path for path in set(objects.values()) if os.path.exists(path)}
    known = {name for name, path in objects.items() if path in others}
    text_path, made, links = f"{cpp_path}.part.cpp", f"{obj_path}.part.o", f"{obj_path}.links"
    text, linked = written(source, keys, called, known)
    Path(text_path).write_text(text, encoding="utf-8")
    Path(links).write_text(linked)
    _build(made, text_path, **settings)
    path = store.add(sorted({keys[name] for name in shared - known}), made)
    command = [LINKER, "-r", "--gc-sections", "-z", "muldefs", "-o", obj_path]
    subprocess.run([*command, path, *sorted(others), links], check=True)
    os.remove(text_path)
    os.remove(links)


wp._src.build.build_cpu = build

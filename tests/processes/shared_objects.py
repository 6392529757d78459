# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Compiles a function that kernels call once, not once for each module that holds it.

Kernels that are not optimised consist of the functions that Warp writes for them, one by one: clang
puts none of them in line, unless it is told to. Scenes that differ in an effect share most of them.
So what one module is compiled from is compiled without the functions that other modules have been
compiled with before, and the linker takes those from there. The machine code is the same as if all
were compiled at once.
"""

import hashlib
import os
import re
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import warp as wp

LINKER = shutil.which("ld") if os.name == "posix" else None
"""Without one, modules are compiled as Warp does it."""

_HEAD = re.compile(r"^static ((?:WP_\w+ |CUDA_CALLABLE )*)([^\n(;]*?)\b(\w+)\(\n", re.M)
_END = "\n}\n"
_BETWEEN = re.compile(r"(?:\s|//[^\n]*\n)*\Z")
_CALL = re.compile(r"\b(?<!::)(\w+_\d+)(?=\()")
_KERNELS = re.compile(r"^struct wp_args_", re.M)
_KERNEL = re.compile(r"^(template <[^\n]*>\n)?static void (?=\w+_cpu_kernel_forward\()", re.M)
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


def keys_of(functions: dict[str, Function], settings: str) -> dict[str, str]:
    """By name, what tells a function, with all that it calls, from others."""
    keys: dict[str, str] = {}

    def key_of(name: str) -> str:
        if name not in keys:
            function = functions[name]
            text = "".join(function.heads + function.texts).replace(name, "")
            of_callees = "".join(f"{callee}{key_of(callee)}" for callee in sorted(function.callees))
            keys[name] = hashlib.md5(f"{settings}{text}{of_callees}".encode()).hexdigest()
        return keys[name]

    for name in functions:
        key_of(name)
    return keys


class Store:
    """Object files with functions, in Warp's cache, which processes share."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        folder.mkdir(parents=True, exist_ok=True)
        self.seen: set[str] = set()
        self.objects: dict[str, str] = {}

    def look(self) -> None:
        """Finds the functions that have been added."""
        for entry in os.scandir(self.folder):
            if entry.name.endswith(".keys") and entry.name not in self.seen:
                self.seen.add(entry.name)
                path = entry.path.removesuffix(".keys") + ".o"
                for key in Path(entry.path).read_text().split():
                    self.objects.setdefault(key, path)

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


def written(source: Source, keys: dict[str, str], known: set[str]) -> str:
    """The source of a module without the functions that are known, which it declares."""

    def renamed(text: str) -> str:
        return _CALL.sub(lambda call: f"f_{keys[call[1]]}" if call[1] in keys else call[1], text)

    parts, done = [source.start], set()
    for name, function in source.functions.items():
        if keys[name] in done:  # under another name
            continue
        done.add(keys[name])
        attributes = "static WP_FORCEINLINE "
        if not function.is_inline:
            key = keys[name]
            attributes = f'__attribute__((weak, noinline, section(".ltext.{key}"))) '
        for head, text in zip(function.heads, function.texts, strict=True):
            first = attributes + head.replace(f"{name}(", f"f_{keys[name]}(", 1)
            parts.append(f"{first};\n" if name in known else f"{first}\n{renamed(text)}\n")
    own = hashlib.md5(source.kernels.encode()).hexdigest()
    section = rf'\1__attribute__((section(".ltext.k{own}"))) static void '
    return "".join(parts) + _KERNEL.sub(section, renamed(source.kernels))


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
    keys = keys_of(source.functions, f"{before}{options}")
    shared = {name for name, function in source.functions.items() if not function.is_inline}
    known = {name for name in shared if keys[name] in store.objects}
    text_path, made = f"{cpp_path}.part.cpp", f"{obj_path}.part.o"
    Path(text_path).write_text(written(source, keys, known), encoding="utf-8")
    _build(made, text_path, **settings)
    others = {store.objects[keys[name]] for name in known}
    path = store.add(sorted({keys[name] for name in shared - known}), made)
    entries = _ENTRY.findall(source.kernels)
    command = [LINKER, "-r", "--gc-sections", "-z", "muldefs", "-o", obj_path]
    command += [option for entry in entries for option in ("-u", entry)]
    subprocess.run([*command, path, *sorted(others)], check=True)


wp._src.build.build_cpu = build

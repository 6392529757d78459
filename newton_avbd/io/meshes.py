# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""Finding the meshes and textures that a URDF file names.

URDF names them by ``package://NAME/PATH`` (``model://`` likewise), by ``file://`` or by a path
beside the file, or, in files of PyBullet, beside a folder above it. Newton's importer looks for
packages in the environment and in one folder; a robot that was copied out of its workspace has them
in another folder above the file.
"""

import os
from collections.abc import Collection, Iterator
from pathlib import Path
from urllib.parse import unquote, urlsplit
from xml.etree import ElementTree

from .urdf import parse

SEARCHED = ("ROS_PACKAGE_PATH", "GZ_SIM_RESOURCE_PATH", "GAZEBO_MODEL_PATH", "AMENT_PREFIX_PATH")
"""Environment variables that list folders of packages; those of the last have them in share."""


def read_urdf(
    path: Path, unreadable: Collection[str] = ()
) -> tuple[ElementTree.Element, tuple[str, ...]]:
    """Read a URDF file with the paths of its meshes and textures resolved.

    Args:
        path: The file.
        unreadable: Absolute paths of files to leave out, too.

    Returns:
        The file's root element, in which every mesh and texture that was found has an absolute path
        and each one that was not found is left out, with the shape that consists of it; and the
        names of those that were not found, as the file writes them.

    Raises:
        xml.etree.ElementTree.ParseError: The file is no XML.
        ValueError: It is no URDF file that can be read; the message says where and why.
    """
    root = parse(path)
    parents = {child: parent for parent in root.iter() for child in parent}
    absent: dict[str, None] = {}
    for element in [*root.iter("mesh"), *root.iter("texture")]:
        name = element.get("filename")
        if name is None or name.startswith(("http://", "https://")):
            continue
        found = find_asset(name, path)
        if found is not None and str(found) not in unreadable:
            element.set("filename", str(found))
            continue
        absent[name] = None
        parents[element].remove(element)
    return root, tuple(absent)


def broken_mesh(root: ElementTree.Element) -> str | None:
    """Path of the first mesh that its reader fails on; None where all can be loaded."""
    import trimesh

    for name in dict.fromkeys(str(mesh.get("filename")) for mesh in root.iter("mesh")):
        try:
            trimesh.load(name, force="mesh")
        except Exception:
            return name
    return None


def remedy(name: str) -> str:
    """What to do about a file that was not found, as the URDF file writes its name."""
    if "://" in name and not name.startswith("file://"):
        return "set ROS_PACKAGE_PATH to the folder that holds the package"
    return "there is no such file"


def find_asset(name: str, urdf: Path) -> Path | None:
    """Find the file that a URDF file means by ``name``.

    A package is looked for in the folders of :data:`SEARCHED`, then in every folder above the
    URDF file, the nearest first. Where none of these holds a folder of the package's name, the
    folders above are tried as the package itself, whose folder may have another name. A path is
    tried from the folder of the URDF file, then from every folder above it.

    Args:
        name: A URI or a path, as the file writes it.
        urdf: The URDF file.

    Returns:
        The absolute path; None where there is no such file.
    """
    scheme, _, rest = name.partition("://")
    if not rest:
        places: Iterator[Path] = (folder / name for folder in urdf.absolute().parents)
    elif scheme == "file":
        places = iter([Path(unquote(urlsplit(name).path))])
    else:
        places = _places(Path(unquote(rest).lstrip("/")), urdf.absolute())
    return next((place.absolute() for place in places if place.is_file()), None)


def _places(named: Path, urdf: Path) -> Iterator[Path]:
    """Where ``named``, a package and a path in it, may be."""
    folders = [*_searched(), *urdf.parents]
    yield from (folder / named for folder in folders)
    inside = Path(*named.parts[1:])
    # An entry of a search path may be the package.
    yield from (folder / inside for folder in folders if folder.name == named.parts[0])
    yield from (folder / inside for folder in urdf.parents)


def _searched() -> Iterator[Path]:
    for variable in SEARCHED:
        for entry in os.environ.get(variable, "").split(os.pathsep):
            if entry.strip():
                folder = Path(entry.strip())
                yield folder / "share" if variable == "AMENT_PREFIX_PATH" else folder

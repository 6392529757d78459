# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""Newton's viewers, and pictures without a window."""

import os
import sys
from pathlib import Path
from typing import Any

import newton
import newton.viewer
import numpy as np
import warp as wp

from newton_avbd.io.errors import UserError, is_installed, missing, require

WINDOWS = ("gl", "rerun", "viser")
"""Those that are watched while the simulation runs."""

PICTURE_SIZE = (1280, 720)
"""Width and height of a picture [px]."""

NO_CONTEXT = (
    "cannot open an OpenGL context: {reason}\n"
    "Without a display, install EGL (Debian and Ubuntu: apt install libegl1 libgl1-mesa-dri), "
    "or run under xvfb-run -a."
)


def make_viewer(name: str, scene: str, *, headless: bool = False) -> Any:
    """Make one of Newton's viewers.

    Args:
        name: One of :data:`~newton_avbd.io.names.VIEWERS`.
        scene: Scene name, after which a USD file is named.
        headless: Whether the ``gl`` viewer draws without a window.

    Returns:
        The viewer.

    Raises:
        UserError: Its package is not installed, or there is no OpenGL.
    """
    if name == "gl":
        return _make_gl(headless)
    if name == "usd":
        require("pxr")
        path = f"{Path(scene.rpartition(':')[2]).stem}.usd"
        return newton.viewer.ViewerUSD(path, num_frames=None)
    if name == "rerun":
        require("rerun")
        return newton.viewer.ViewerRerun()
    if name == "viser":
        require("viser")
        return newton.viewer.ViewerViser()
    return newton.viewer.ViewerNull(num_frames=sys.maxsize)


def choose_viewer() -> str:
    """The viewer to watch with: a window, or a page in the browser where none can be opened.

    Raises:
        UserError: Nothing that shows a simulation is installed.
    """
    if _has_display() and is_installed("pyglet", "imgui_bundle"):
        return "gl"
    if is_installed("viser"):
        return "viser"
    raise missing("viser")


def _has_display() -> bool:
    return sys.platform != "linux" or bool(os.environ.get("DISPLAY"))


def _make_gl(headless: bool) -> Any:
    require("pyglet")
    if not headless:
        require("imgui_bundle")
    import pyglet

    if not _has_display():
        if not headless:
            raise UserError(
                "there is no display to open a window on; --viewer viser shows the scene in a "
                "browser, --png FILE draws a picture"
            )
        pyglet.options["headless"] = True  # draw by EGL
    width, height = PICTURE_SIZE
    try:
        return newton.viewer.ViewerGL(width=width, height=height, headless=headless)
    except Exception as error:
        # pyglet and the driver fail in as many ways as there are platforms.
        reason = str(error).strip() or type(error).__name__
        raise UserError(NO_CONTEXT.format(reason=reason)) from error


def camera(viewer: Any) -> tuple[float, ...]:
    """Where a ``gl`` viewer's camera is, and how it is turned."""
    return (*viewer.camera.pos, viewer.camera.yaw, viewer.camera.pitch)


def look_at(viewer: Any, model: newton.Model, state: newton.State) -> None:
    """Point a ``gl`` viewer's camera at the bodies, obliquely from above, so that all are seen."""
    centers = state.body_q.numpy()[:, :3].astype(float)
    radius = model.shape_collision_radius.numpy()[model.shape_body.numpy() >= 0]
    reach = float(np.max(radius, initial=0.1))
    middle = 0.5 * (centers.min(axis=0) + centers.max(axis=0))
    back = np.array([0.35, -0.9, 0.3]) / np.linalg.norm([0.35, -0.9, 0.3])
    right = np.array([-back[1], back[0], 0.0]) / np.hypot(back[0], back[1])
    half_height = np.tan(np.radians(0.5 * viewer.camera.fov))
    half_width = half_height * PICTURE_SIZE[0] / PICTURE_SIZE[1]
    offset = centers - middle
    across = (np.abs(offset @ right) + reach) / half_width
    upward = (np.abs(offset @ np.cross(back, right)) + reach) / half_height
    distance = 1.1 * float(np.max(np.maximum(across, upward) + offset @ back))
    viewer.set_camera(
        pos=wp.vec3(*(middle + distance * back)),
        pitch=-float(np.degrees(np.arcsin(back[2]))),
        yaw=float(np.degrees(np.arctan2(-back[1], -back[0]))),
    )


def check_picture(path: Path) -> None:
    """Check before the work that the ending of a file's name asks for a kind of image.

    Raises:
        UserError: It asks for none that can be written.
    """
    require("PIL")
    from PIL import Image

    kind = Image.registered_extensions().get(path.suffix.lower())
    if kind not in Image.SAVE:
        raise UserError(f"cannot draw {path}: its ending is none of an image, such as .png or .jpg")


def save_picture(viewer: Any, path: Path, size: tuple[int, int] | None = None) -> None:
    """Write what a ``gl`` viewer drew last to an image file.

    Args:
        viewer: The viewer.
        path: The file; its ending says the format.
        size: Width and height [px]; None for those of the viewer.

    Raises:
        UserError: The file cannot be written.
    """
    require("PIL")
    from PIL import Image

    try:
        image = Image.fromarray(viewer.get_frame().numpy())
        (image if size is None else image.resize(size, Image.Resampling.LANCZOS)).save(path)
    except (OSError, ValueError) as error:
        raise UserError(f"cannot write {path}: {error}") from error

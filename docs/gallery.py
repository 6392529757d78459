# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Draws the animations of the gallery, without a window.

python docs/gallery.py [NAME ...]

Needs the extras ``scenes`` and ``view``, and OpenGL: on a machine without a display, EGL or
``xvfb-run -a``.
"""

import argparse
import sys
from dataclasses import dataclass
from pathlib import Path

from PIL import Image

from newton_avbd.commands import view
from newton_avbd.io.opening import open_scene
from newton_avbd.io.simulation import ModelSimulation, Request
from newton_avbd.io.terminal import gathered_warnings, interruptible, progress, start_warp

FOLDER = Path(__file__).parent / "images" / "gallery"
SIZE = (480, 270)
"""Width and height of an animation [px]."""

EVERY = 4
"""Frames of a simulation, 60 a second, for each picture."""


@dataclass(frozen=True)
class Animation:
    """An animation.

    Attributes:
        scene: What ``newton-avbd run`` calls the scene.
        frames: Frames of 1/60 s.
        arguments: For an example of Newton.
    """

    scene: str
    frames: int
    arguments: tuple[str, ...] = ()


ANIMATIONS = {
    "domino_spiral": Animation("newton:domino_spiral", 360),
    "humanoid": Animation("humanoid", 150),
    "newton_cradle": Animation("newton:newton_cradle", 240),
}


def draw(name: str, animation: Animation) -> None:
    """Simulate a scene with SolverAVBD and write its pictures as one animated WebP file."""
    viewer = view.make_viewer("gl", animation.scene, headless=True)
    start = view.camera(viewer)
    request = Request(solver="avbd", viewer=lambda: viewer, arguments=animation.arguments)
    with gathered_warnings():
        simulation = open_scene(animation.scene, request)
    if isinstance(simulation, ModelSimulation) or view.camera(viewer) == start:
        view.look_at(viewer, simulation.model, simulation.state)
    pictures = []
    for frame in progress(range(animation.frames), animation.frames, name):
        if frame % EVERY == 0:
            simulation.render()
            picture = Image.fromarray(viewer.get_frame().numpy())
            pictures.append(picture.resize(SIZE, Image.Resampling.LANCZOS))
        simulation.advance()
    viewer.close()
    file = FOLDER / f"{name}.webp"
    duration = 1000 * EVERY // 60
    pictures[0].save(
        file, save_all=True, append_images=pictures[1:], duration=duration, loop=0, quality=60
    )
    print(f"{file.name}: {len(pictures)} pictures, {file.stat().st_size / 1024:.0f} KiB")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(ANIMATIONS)}")
    args = parser.parse_args()
    start_warp()
    FOLDER.mkdir(exist_ok=True)
    if unknown := [name for name in args.names if name not in ANIMATIONS]:
        parser.error(f"there is no animation {unknown[0]!r}; there are: {', '.join(ANIMATIONS)}")
    with interruptible() as interruption:
        for name in args.names or ANIMATIONS:
            draw(name, ANIMATIONS[name])
    return interruption.status(0)


if __name__ == "__main__":
    sys.exit(main())

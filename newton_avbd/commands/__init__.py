# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""The commands of ``newton-avbd``, one module each, and what ``--help`` says of them."""

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class Command:
    """A command.

    Attributes:
        module: Where its ``main`` is; its arguments are in :mod:`newton_avbd.commands.arguments`.
        summary: What it does.
        examples: What to type after ``newton-avbd NAME``, and what that does.
        names: What ``--list`` names.
        catalog: The module whose ``catalog()`` has these names and what they are, under headings;
            None for :attr:`module`.
        or_files: Whether files may stand for names.
    """

    module: str
    summary: str
    examples: tuple[tuple[str, str], ...]
    names: str = "scenes"
    catalog: str | None = None
    or_files: bool = False


PURPOSES: dict[str, dict[str, Command]] = {
    "simulate": {
        "run": Command(
            "newton_avbd.commands.run",
            "simulate a scene, a robot or a file",
            (
                ("quadruped --viewer auto", "watch it, in a window or a browser"),
                ("quadruped --png quadruped.png", "a picture, without a window"),
                ("robot.urdf --solver mujoco", "a file of your own, by another solver"),
            ),
            names="scenes, examples and robots",
            catalog="newton_avbd.io.opening",
            or_files=True,
        ),
        "compare": Command(
            "newton_avbd.commands.compare",
            "simulate a scene with two solvers and compare them",
            (
                ("pyramid --against xpbd", "a table"),
                ("domino_spiral --png spiral.png", "with plots over time"),
                ("robot.xml --against mujoco --ctrl sine", "drive the actuators of an MJCF file"),
            ),
            names="scenes, examples and robots",
            catalog="newton_avbd.io.opening",
            or_files=True,
        ),
        "effects": Command(
            "newton_avbd.commands.effects",
            "say which effects a scene calls for, why, and what they cost",
            (
                ("robot:nv_ant", "which, and why"),
                ("robot:nv_ant --measure", "and what each costs in time"),
            ),
            names="scenes, examples and robots",
            catalog="newton_avbd.io.opening",
            or_files=True,
        ),
    },
    "try robots": {
        "robots": Command(
            "newton_avbd.commands.robots",
            "try the robots of installed packages, and say which move right",
            (
                ("--list", "names of all robots"),
                ("nv_ant panda", "try two of them"),
                ("gymnasium --output out", "try those of a package, and write a page"),
            ),
            names="robots",
            catalog="newton_avbd.io.robots",
        ),
        "falls": Command(
            "newton_avbd.commands.falls",
            "drop, spin and throw robots, and measure energy that appears",
            (
                ("nv_ant --kinds fallen --seeds 2", "drop a robot twice"),
                ("robot.urdf --solvers avbd mujoco", "a file of your own, by two solvers"),
                ("--replay out/nv_ant-fallen-1.json", "repeat a fall that failed"),
            ),
            names="robots",
            catalog="newton_avbd.io.robots",
            or_files=True,
        ),
        "learning": Command(
            "newton_avbd.commands.learning",
            "step tasks of dm_control and gymnasium, with MuJoCo beside",
            (
                ("gymnasium/Ant-v5", "one task"),
                ("--episodes 2 --controls 100", "all tasks, shorter"),
            ),
            names="tasks",
        ),
    },
    "measure": {
        "bench": Command(
            "newton_avbd.study.bench.run",
            "measure time and quality on a set of scenes",
            (
                ("pyramid --quick", "one scene, rough"),
                ("stack --solvers avbd mj_step --json out.json", "two solvers, to a file"),
            ),
        ),
        "accuracy": Command(
            "newton_avbd.commands.accuracy",
            "measure what accuracy costs in time",
            (
                ("--quick", "some scenes, in two minutes"),
                ("--quick --output out", "with plots; a second run goes on where this ended"),
                ("--ask robot:nv_ant", "what each accuracy costs in a scene of your own"),
            ),
        ),
        "growth": Command(
            "newton_avbd.commands.growth",
            "measure how time and memory grow with a scene",
            (("boxes --most 1000", "one scene, up to a thousand bodies"),),
        ),
        "large": Command(
            "newton_avbd.commands.large",
            "measure one large world, of any size",
            (("--bodies 1000 --steps 10", "all scenes, of a thousand bodies"),),
        ),
        "stability": Command(
            "newton_avbd.commands.stability",
            "run cases that are hard to keep stable",
            (
                ("--quick", "all but those that take minutes"),
                ("heavy --solvers avbd xpbd --output out", "some, by two solvers, with a page"),
            ),
            names="cases",
        ),
        "properties": Command(
            "newton_avbd.study.properties.run",
            "try solvers on what a scene can author",
            (("joint_friction --solvers avbd xpbd", "some properties, by two solvers"),),
            names="properties",
        ),
    },
}
"""The commands by what they are for, in the order in which they are shown."""

COMMANDS: dict[str, Command] = {
    name: command for group in PURPOSES.values() for name, command in group.items()
}
"""The commands by name."""


def overview() -> str:
    """The short list of commands by purpose, as text for a terminal."""
    lines = []
    for purpose, group in PURPOSES.items():
        lines.append(f"{purpose}:")
        lines += [f"  {name:<12} {command.summary}" for name, command in group.items()]
    lines += [
        "start with:",
        "  newton-avbd run quadruped --viewer auto",
        "`newton-avbd COMMAND --help` shows arguments and examples, `--list` scenes and robots.",
    ]
    return "\n".join(lines)


def examples(name: str) -> str:
    """The examples of a command, as text for a terminal."""
    typed = [(f"newton-avbd {name} {text}", what) for text, what in COMMANDS[name].examples]
    width = max(len(line) for line, _ in typed)
    return "examples:\n" + "\n".join(f"  {line:<{width}}  {what}" for line, what in typed)


def listing(catalog: Mapping[str, Mapping[str, str]]) -> str:
    """Names and what they are, a line each under their headings, as text for a terminal."""
    lines = []
    for heading, entries in catalog.items():
        width = max(map(len, entries), default=0)
        lines.append(f"{heading}:")
        lines += [f"  {name:<{width}}  {what}".rstrip() for name, what in entries.items()]
    return "\n".join(lines)

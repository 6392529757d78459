# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""``python -m newton_avbd.study.robots.speed [NAMES]``: a robot's step beside MuJoCo's ``mj_step``.

Robots come out of the packages ``example-robot-data`` (URDF), ``dm_control`` and ``gymnasium``
(MJCF), where they are installed. Nothing collides. Joints of URDF robots hold their first pose by
drives, those of MJCF robots do what their file says. URDF robots are imported plainly, and once
more with ``collapse_fixed_joints=True``. SolverAVBD's steps are replayed from a graph, ``mj_step``
runs on what SolverMuJoCo makes of the model with the fewest links, with MuJoCo's default integrator
(Euler). All take turns in one process on one core.
"""

import argparse
import math
import sys
import sysconfig
import xml.etree.ElementTree as ET
from collections.abc import Iterable
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from pathlib import Path

import newton
import numpy as np

from newton_avbd.io.terminal import interruptible, progress, say
from newton_avbd.scenes.named import Scene
from newton_avbd.scenes.robots import place
from newton_avbd.study.bench.run import chosen, pinned
from newton_avbd.study.contestants import Contestant, NewtonContestant
from newton_avbd.study.mujoco.native import MujocoContestant, silence
from newton_avbd.study.peers import PEERS

REPEATS = 7
"""Turns of each solver."""
TURN = 0.05
"""CPU time of a turn [s]."""
SETTLING = 0.5
"""Time that is simulated before any is measured [s]."""
DRIVE_KE = 1000.0
"""Stiffness of the drives that hold URDF robots [N/m or N m/rad]."""
DRIVE_KD = 10.0
"""Their damping [N s/m or N m s/rad]."""
FALLING = ("a1", "anymal", "b1", "bolt", "g1", "go1", "go2", "hyq", "laikago", "solo")
"""How the names of URDF robots begin whose base floats; others are bolted down."""


@dataclass(frozen=True)
class Timing:
    """Median times of a step [us]."""

    robot: str
    dofs: int
    links: int
    sweeps: float
    ours: float
    collapsed: float
    mujoco: float

    @property
    def ratio(self) -> float:
        """Ours as a share of MuJoCo's."""
        return self.ours / self.mujoco

    @property
    def welds(self) -> float:
        """Ours of the plain import as a share of that with fixed joints collapsed."""
        return self.ours / self.collapsed


def robots() -> dict[str, Path]:
    """Files of the robots that are installed, by name."""
    found: dict[str, Path] = {}
    data = Path(sysconfig.get_paths()["purelib"]) / "cmeel.prefix/share/example-robot-data/robots"
    for path in sorted(data.glob("*/*/*.urdf")):
        found[path.stem] = path
    for package, folder in (("dm_control", "suite"), ("gymnasium", "envs/mujoco/assets")):
        spec = find_spec(package)
        if spec is not None and spec.submodule_search_locations:
            prefix = "dm" if package == "dm_control" else "gym"
            root = Path(spec.submodule_search_locations[0]) / folder
            for path in sorted(root.glob("*.xml")):
                found[f"{prefix}_{path.stem}"] = path
    return found


def add_robot(path: Path, collapse: bool, builder: newton.ModelBuilder) -> None:
    """Add a robot of which nothing collides; with ``collapse`` fixed joints of a URDF are gone."""
    if path.suffix == ".urdf":
        _add_urdf(path, collapse, builder)
    else:
        builder.add_mjcf(str(path), parse_visuals=False, parse_sites=False)
    for shape in range(builder.shape_count):
        builder.shape_flags[shape] &= ~newton.ShapeFlags.COLLIDE_SHAPES
    place(builder)


def _add_urdf(path: Path, collapse: bool, builder: newton.ModelBuilder) -> None:
    """Add a robot without its shapes, held by drives at its first pose within its limits."""
    tree = ET.parse(path).getroot()
    for link in tree.iter("link"):
        for shape in [*link.findall("visual"), *link.findall("collision")]:
            link.remove(shape)
    floating = path.stem.startswith(FALLING)
    builder.add_urdf(
        ET.tostring(tree, encoding="unicode"), floating=floating, collapse_fixed_joints=collapse
    )
    for joint, kind in enumerate(builder.joint_type):
        if kind not in (newton.JointType.REVOLUTE, newton.JointType.PRISMATIC):
            continue
        dof, at = builder.joint_qd_start[joint], builder.joint_q_start[joint]
        lower, upper = builder.joint_limit_lower[dof], builder.joint_limit_upper[dof]
        q = min(max(builder.joint_q[at], lower), upper)
        builder.joint_q[at] = builder.joint_target_q[at] = q
        builder.joint_target_mode[dof] = int(newton.JointTargetMode.POSITION)
        builder.joint_target_ke[dof] = DRIVE_KE
        builder.joint_target_kd[dof] = DRIVE_KD


def time_robot(name: str, path: Path) -> Timing:
    """Time a robot's step in both solvers and both imports, taking turns."""
    is_urdf = path.suffix == ".urdf"
    imports = (False, True) if is_urdf else (False,)
    scenes = [Scene(name, str(path), partial(add_robot, path, each)) for each in imports]
    ours = [NewtonContestant(scene, PEERS["avbd"]) for scene in scenes]
    for contestant in ours:
        for _ in range(round(SETTLING / contestant.scene.dt)):
            contestant.advance()
    mujoco = _mujoco(scenes[-1])
    sides: list[Contestant] = [*ours, *([mujoco] if mujoco else [])]
    times = np.array([[1e6 * side.replayed(TURN) for side in sides] for _ in range(REPEATS)])
    medians = np.median(times, axis=0)
    return Timing(
        name,
        ours[0].model.joint_dof_count,
        ours[0].model.body_count,
        float(ours[0].solver.report().sweeps.max()),
        medians[0],
        medians[1] if is_urdf else math.nan,
        medians[-1] if mujoco else math.nan,
    )


def _mujoco(scene: Scene) -> MujocoContestant | None:
    """MuJoCo on a scene without contacts; None where it cannot load it."""
    import mujoco

    try:
        contestant = MujocoContestant(scene)
    except Exception:
        # SolverMuJoCo and MuJoCo refuse robots in as many ways as files can be wrong.
        return None
    options = contestant.mj_model.opt
    options.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    options.integrator = mujoco.mjtIntegrator.mjINT_EULER
    contestant.restart()
    for _ in range(round(SETTLING / scene.dt)):
        contestant.advance()
    return contestant


def summary(timings: Iterable[Timing]) -> str:
    """Median and geometric mean of the ratios, and the robots above what is asked of them."""
    lines = []
    for what, most in (("ratio", 1.0), ("welds", 1.1)):
        ratios = {t.robot: getattr(t, what) for t in timings}
        ratios = {robot: value for robot, value in ratios.items() if math.isfinite(value)}
        if not ratios:
            continue
        values = np.array(list(ratios.values()))
        above = sorted((r for r in ratios if ratios[r] > most), key=lambda r: -ratios[r])
        lines.append(
            f"{what} of {len(values)} robots: median {np.median(values):.2f}, geometric mean "
            f"{np.exp(np.mean(np.log(values))):.2f}, above {most:g}: {', '.join(above) or 'none'}"
        )
    return "\n".join(lines)


def main(names: list[str]) -> int:
    """Time robots and print a table; 0, or 130 after Ctrl-C.

    All that are installed, unless some are named.
    """
    parser = argparse.ArgumentParser(prog="python -m newton_avbd.study.robots.speed")
    parser.add_argument("names", nargs="*", metavar="NAME")
    known = robots()
    wanted = chosen("robot", parser.parse_args(names).names, tuple(known))
    silence()
    timings = []
    print("| robot | dofs | links | sweeps | plain [us] | collapsed | mj_step | ratio | welds |")
    print("| --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: |")
    with pinned(), interruptible() as interruption:
        for name in progress(wanted, len(wanted), "robots", str):
            try:
                t = time_robot(name, known[name])
            except Exception as error:
                # A robot that an importer or a solver refuses must not keep the others from it.
                reason = str(error).strip().partition("\n")[0]
                say(f"| {name} | {type(error).__name__}: {reason} | | | | | | | |")
                continue
            timings.append(t)
            say(
                f"| {t.robot} | {t.dofs} | {t.links} | {t.sweeps:.0f} | {t.ours:.2f} "
                f"| {t.collapsed:.2f} | {t.mujoco:.2f} | {t.ratio:.2f} | {t.welds:.2f} |"
            )
    print(f"\n{summary(timings)}")
    return interruption.status(0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

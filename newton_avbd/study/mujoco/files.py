# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""MJCF files in SolverAVBD and in MuJoCo C, passive and driven, without contacts for 0.4 s.

Run as ``python -m newton_avbd.study.mujoco.files [NAME ...]``. A NAME is part of the name of a file
of dm_control's suite or of gymnasium, or the path of a file, or of a folder whose files are tried.
``--page docs/mujoco_files.md`` writes the orders of convergence into that page.

Joint limits are soft in MuJoCo and, but for ``compliant_contacts=True``, rigid in SolverAVBD. So
there are two comparisons, each of like with like:

- *as authored*: SolverAVBD(compliant_contacts=True) beside MuJoCo, both at 1/2000 s;
- *rigid limits*: SolverAVBD as it is beside MuJoCo at 1/40000 s with limits as stiff as that step
  allows, overdamped, so that nothing rebounds. Both start within the limits of
  joints and tendons, and where equality constraints hold.

Equality constraints, but for those of mocap bodies, and joint friction are rigid in SolverAVBD
either way, so MuJoCo has them as stiff as its step allows in both.

A case holds if no body is off by more than 2 % of how far it moved, or 1 mm. The errors are those
of the body that comes next to its bound or misses it by most, of SolverAVBD and of MuJoCo, as
shares of the bound: 1 just holds. Beside them stand those of both against MuJoCo at 1/40000 s.
"""

import argparse
import sys
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import newton
import numpy as np
from newton.solvers import SolverMuJoCo

from newton_avbd import SolverAVBD
from newton_avbd.io.controls import Controls
from newton_avbd.io.mjcf import add_mjcf
from newton_avbd.io.robots import robots
from newton_avbd.io.terminal import interruptible, progress, say
from newton_avbd.measure.state import Array
from newton_avbd.model.welds import is_kinematic
from newton_avbd.scenes.finalize import finalized

DT = 1.0 / 2000.0
FINE = 1.0 / 40000.0
"""Time step of references [s]."""
SECONDS = 0.4
LOOKS = 20
"""How often in that time it is looked where bodies are."""
SHARE = 0.02
"""Of how far a body moves, by which it may be off."""
LIMITED = ("JOINT", "TENDON")
"""What has limits, as ``mjtConstraint`` names it."""
NEWTON_STEPS = 50
"""How many steps at most bring a start pose within limits."""
LEAST = 1.0e-3
"""How far any body may be off [m]."""
PACKAGES = ("dm_control", "gymnasium")
ORDERS = (
    "dm_control/acrobot",
    "dm_control/walker",
    "gymnasium/half_cheetah",
    "gymnasium/inverted_double_pendulum",
)
"""Files whose order of convergence the page shows."""
STEPS = (1.0 / 500.0, 1.0 / 1000.0, 1.0 / 2000.0, 1.0 / 4000.0)
BEGIN = "<!-- orders: python -m newton_avbd.study.mujoco.files --page docs/mujoco_files.md -->"
END = "<!-- end of orders -->"


@dataclass(frozen=True)
class Case:
    """A file, with or without controls of its actuators."""

    model: newton.Model
    path: Path
    is_driven: bool
    hold: float = 0.0
    """How long each control lasts [s]; 0 for the time step. (A control that a step holds is late by
    half of it, which makes any solver one of first order.)"""

    def controls(self) -> Controls | None:
        """What drives the actuators; None where nothing does."""
        count = self.model.custom_frequency_counts.get("mujoco:actuator", 0)
        return Controls("sine", self.model, self.path) if self.is_driven and count else None

    def state(self, within: bool) -> newton.State:
        """The pose of the file, or, where constraints do not hold, one close by where they do."""
        model, state = self.model, self.model.state()
        joint_q = model.joint_q.numpy().copy()
        if within:
            starts, dofs = model.joint_q_start.numpy(), model.joint_qd_start.numpy()
            lower, upper = model.joint_limit_lower.numpy(), model.joint_limit_upper.numpy()
            for joint in range(model.joint_count):
                axes = slice(dofs[joint], dofs[joint + 1])
                count = axes.stop - axes.start
                if starts[joint + 1] - starts[joint] == count:
                    at = slice(starts[joint], starts[joint + 1])
                    joint_q[at] = np.clip(joint_q[at], lower[axes], upper[axes])
        state.joint_q.assign(joint_q)
        newton.eval_fk(model, state.joint_q, state.joint_qd, state)
        if within:
            _enter_limits(model, state)
        return state


def _enter_limits(model: newton.Model, state: newton.State) -> None:
    """Moves a state to where limits and equality constraints hold, as near as it gets.

    Newton steps of MuJoCo's rows move it, each by the least kinetic energy. A state where they hold
    stays.
    """
    import mujoco

    solver = _native(model, state)
    native, now = solver.mj_model, solver.mj_data
    native.opt.jacobian = int(mujoco.mjtJacobian.mjJAC_DENSE)
    equality = int(mujoco.mjtConstraint.mjCNSTR_EQUALITY)
    ranges = [int(getattr(mujoco.mjtConstraint, f"mjCNSTR_LIMIT_{end}")) for end in LIMITED]
    gives = np.append(_is_led(model, solver), False)
    is_within = True
    for _ in range(NEWTON_STEPS):
        mujoco.mj_forward(native, now)
        kinds = now.efc_type
        # a limit holds where its margin begins
        beyond = now.efc_pos - now.efc_margin
        beyond = np.where(kinds == equality, now.efc_pos, np.minimum(beyond, 0.0))
        beyond[~np.isin(kinds, [equality, *ranges])] = 0.0
        beyond[(kinds == equality) & gives[np.minimum(now.efc_id, gives.size - 1)]] = 0.0
        rows = np.flatnonzero(beyond)
        if np.abs(beyond).max(initial=0.0) < 1.0e-9:
            break
        is_within = False
        jacobian = now.efc_J.reshape(-1, native.nv)[rows]
        moved = np.zeros_like(jacobian)
        mujoco.mj_solveM(native, now, moved, jacobian)
        move = -moved.T @ np.linalg.lstsq(jacobian @ moved.T, beyond[rows], rcond=1.0e-9)[0]
        mujoco.mj_integratePos(native, now.qpos, move, 1.0)
    if is_within:
        return
    owners, known = _owners(solver)
    pose = state.body_q.numpy()
    pose[owners[known], :3] = now.xpos[known]
    pose[owners[known], 3:] = np.roll(now.xquat[known], -1, axis=1)
    state.body_q.assign(pose)
    newton.eval_ik(model, state, state.joint_q, state.joint_qd)
    newton.eval_fk(model, state.joint_q, state.joint_qd, state)


def _native(model: newton.Model, start: newton.State) -> SolverMuJoCo:
    """MuJoCo C with a model, without contacts, at a state."""
    solver = SolverMuJoCo(model, use_mujoco_cpu=True, disable_contacts=True)
    # a step of next to no time writes the start state down
    solver.step(start, model.state(), model.control(), None, 1.0e-12)
    return solver


def _is_led(model: newton.Model, solver: SolverMuJoCo) -> Any:
    """Which equality constraints tie a body to one that the user moves."""
    import mujoco

    native = solver.mj_model
    is_led = np.append(is_kinematic(model), False)[_owners(solver)[0]]
    is_tie = native.eq_objtype == int(mujoco.mjtObj.mjOBJ_BODY)
    return np.any(is_led[np.where(is_tie, [native.eq_obj1id, native.eq_obj2id], 0)], axis=0)


def _owners(solver: SolverMuJoCo) -> tuple[Any, Any]:
    """Newton's body of each of MuJoCo's, and which of MuJoCo's have one."""
    owners = solver.mjc_body_to_newton.numpy()[0]
    return owners, np.flatnonzero(owners >= 0)


def main() -> int:
    """Print a line for each file and way of driving it; 0, or 130 after Ctrl-C."""
    parser = argparse.ArgumentParser(description="MJCF files beside MuJoCo")
    parser.prog = "python -m newton_avbd.study.mujoco.files"
    parser.add_argument("names", nargs="*", metavar="NAME", help="part of a file's name, or a path")
    parser.add_argument("--scheme", help="of SolverAVBD (default: its own)")
    parser.add_argument("--page", metavar="FILE", help="write the orders of convergence into it")
    args = parser.parse_args()
    warnings.simplefilter("ignore")
    with interruptible() as interruption:
        if args.page:
            write_page(Path(args.page))
        else:
            _compare_files(args.names, args.scheme)
    return interruption.status(0)


def _compare_files(names: list[str], scheme: str | None) -> None:
    """Print a table of files; after Ctrl-C, too, how many of those that were tried hold."""
    print(f"{'':<47}|        as authored         |    rigid limits")
    head = f"{'off [mm]':>10} {'share':>6} {'AVBD':>5} {'MuJoCo':>6}"
    print(f"{'':<47}|{head}|{'off [mm]':>10} {'share':>6}")
    held = dict.fromkeys(((way, kind) for way in (False, True) for kind in range(2)), 0)
    count = 0
    found_files = list(files(names))
    for name, path in progress(found_files, len(found_files), "files", lambda file: file[0]):
        try:
            model = read(path)
            cases = [compare(Case(model, path, way), scheme) for way in (False, True)]
        except Exception as error:  # files can be wrong in as many ways as there are files
            say(f"{name:<40}is not tried: {type(error).__name__}: {str(error)[:100]}")
            continue
        count += 1
        for is_driven, found in zip((False, True), cases, strict=True):
            line = f"{name:<40}{'driven' if is_driven else 'passive':<7}|"
            for kind, (off, shares) in enumerate(found):
                says = "" if shares[0] <= 1.0 else " FAILS"
                held[is_driven, kind] += shares[0] <= 1.0
                line += f"{1.0e3 * off:10.4f}" + "".join(f" {share:6.2f}" for share in shares)
                line += f"{says}|"
            say(line)
    print(
        f"of {count} files hold as authored {held[False, 0]} passive, {held[True, 0]} driven; with "
        f"rigid limits {held[False, 1]} passive, {held[True, 1]} driven"
    )


def files(names: list[str]) -> Iterator[tuple[str, Path]]:
    """Names and paths of the files that are wanted."""
    paths = [Path(name) for name in names if Path(name).exists()]
    for path in paths:
        found = [path] if path.is_file() else sorted(path.rglob("*.xml"))
        for file in found:
            if "<mujoco" in file.read_text(errors="replace"):
                yield str(file.relative_to(path.parent if path.is_file() else path)), file
    wanted = [name for name in names if not Path(name).exists()]
    for robot in robots():
        is_wanted = any(name in robot.name for name in wanted) or not names
        if robot.package in PACKAGES and is_wanted:
            yield robot.name, robot.path


def read(path: Path) -> newton.Model:
    """The model of an MJCF file, with MuJoCo's attributes."""
    builder = newton.ModelBuilder()
    SolverMuJoCo.register_custom_attributes(builder)
    add_mjcf(builder, path, ctrl_direct=True)
    return finalized(builder, device="cpu")


def compare(case: Case, scheme: str | None) -> list[tuple[float, list[float]]]:
    """How far off SolverAVBD is as authored and with rigid limits.

    Returns:
        For each of both how far the worst body is off [m] and errors as shares of the bound: of
        SolverAVBD from MuJoCo, and as authored of each from MuJoCo at :data:`FINE`.
    """
    native, fine = native_path(case, DT), native_path(case, FINE)
    soft = avbd_path(case, DT, scheme=scheme, compliant_contacts=True)
    off, share = worst(soft, native)
    shares = [share, worst(soft, fine)[1], worst(native, fine)[1]]
    stiff = native_path(case, FINE, is_stiff=True)
    rigid_off, rigid_share = worst(avbd_path(case, DT, within=True, scheme=scheme), stiff)
    return [(off, shares), (rigid_off, [rigid_share])]


def worst(path: Array, reference: Array) -> tuple[float, float]:
    """How far the body next to its bound, or beyond it by most, is off at the end.

    Returns:
        The distance [m], and its share of the bound.
    """
    off = np.linalg.norm(path[-1] - reference[-1], axis=1)
    motion = np.linalg.norm(reference - reference[:1], axis=2).max(axis=0)
    share = off / np.maximum(LEAST, SHARE * motion)
    share[~np.isfinite(share)] = np.inf
    found = int(np.argmax(share))
    return float(off[found]), float(share[found])


def avbd_path(case: Case, dt: float, within: bool = False, **settings: Any) -> Array:
    """Places of the bodies in SolverAVBD at the start and :data:`LOOKS` times after it [m].

    Returns:
        Positions, shape (times, bodies, 3).
    """
    model = case.model
    solver, state, after = SolverAVBD(model, **settings), case.state(within), model.state()
    control = model.control()

    def advance(controls: Any) -> None:
        nonlocal state, after
        if controls is not None:
            control.mujoco.ctrl.assign(controls)
        state.clear_forces()
        solver.step(state, after, control, None, dt)
        state, after = after, state

    def look() -> Array:
        return state.body_q.numpy()[:, :3].astype(float)

    return _path(case, dt, advance, look)


def native_path(
    case: Case, dt: float, is_stiff: bool = False, integrator: int | None = None
) -> Array:
    """As :func:`avbd_path`, of ``mj_step`` on what SolverMuJoCo makes of the model.

    Args:
        case: The file.
        dt: Time step [s].
        is_stiff: Whether limits and joint friction are as stiff as the step allows, and not as
            authored, and the bodies start within the limits.
        integrator: MuJoCo's ``mjtIntegrator``; by default that of the file.
    """
    import mujoco

    solver = _native(case.model, case.state(is_stiff))
    native, now = solver.mj_model, solver.mj_data
    now.act[:] = 0.0
    native.opt.timestep = dt
    if integrator is not None:
        native.opt.integrator = integrator
    rigid = ["eq_{}", "dof_{}", "tendon_{}_fri"] + ["jnt_{}", "tendon_{}_lim"] * is_stiff
    owners, known = _owners(solver)
    for kind in rigid:
        # what is tied to a mocap body gives way as authored in both
        stiff = ~_is_led(case.model, solver) if kind.startswith("eq") else slice(None)
        getattr(native, kind.format("solref"))[stiff] = (4.0 * dt, 10.0 if is_stiff else 1.0)
        getattr(native, kind.format("solimp"))[stiff] = (0.9999, 0.9999, 0.001, 0.5, 2.0)
    rows = np.zeros(0, dtype=int)
    if native.nu:
        rows = solver.mjc_actuator_to_newton_idx.numpy().ravel()

    def advance(controls: Any) -> None:
        if controls is not None:
            now.ctrl[:] = controls[rows]
        mujoco.mj_step(native, now)

    def look() -> Array:
        mujoco.mj_kinematics(native, now)
        places = np.zeros((case.model.body_count, 3))
        places[owners[known]] = now.xpos[known]
        return places

    return _path(case, dt, advance, look)


def _path(
    case: Case, dt: float, advance: Callable[[Any], None], look: Callable[[], Array]
) -> Array:
    controls, path = case.controls(), [look()]
    steps = round(SECONDS / dt)
    for step in range(steps):
        time = step * dt
        if case.hold:
            time = np.floor(time / case.hold + 1.0e-6) * case.hold
        advance(None if controls is None else controls.at(time))
        if (step + 1) % (steps // LOOKS) == 0:
            path.append(look())
    return np.array(path)


def write_page(page: Path) -> None:
    """Writes the orders of convergence of :data:`ORDERS` between two marks of a page."""
    import mujoco

    lines = [
        f"| file | solver | {' | '.join(f'1/{1.0 / dt:.0f} s' for dt in STEPS)} | order |",
        "| --- | --- | " + " | ".join("---" for _ in range(len(STEPS) + 1)) + " |",
    ]
    known = {robot.name: robot.path for robot in robots()}
    for name in progress(ORDERS, len(ORDERS), "files", str):
        case = Case(read(known[name]), known[name], True, hold=STEPS[0])
        exact = native_path(case, FINE, integrator=int(mujoco.mjtIntegrator.mjINT_RK4))
        for label, path in (
            ("MuJoCo C", lambda dt, case=case: native_path(case, dt)),
            *(
                (
                    f"SolverAVBD, {scheme}",
                    lambda dt, case=case, scheme=scheme: avbd_path(
                        case, dt, scheme=scheme, compliant_contacts=True
                    ),
                )
                for scheme in ("euler", "generalized_alpha")
            ),
        ):
            off = [float(np.abs(path(dt)[-1] - exact[-1]).max()) for dt in STEPS]
            order = np.polyfit(np.log(STEPS), np.log(off), 1)[0]
            cells = " | ".join(f"{1.0e3 * value:.3g}" for value in off)
            lines.append(f"| {name} | {label} | {cells} | {order:.2f} |")
            say(lines[-1])
    text = page.read_text()
    before, rest = text.split(BEGIN)
    page.write_text(f"{before}{BEGIN}\n\n" + "\n".join(lines) + f"\n\n{END}{rest.split(END)[1]}")


if __name__ == "__main__":
    sys.exit(main())

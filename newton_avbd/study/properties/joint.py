# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""Properties of joints, mostly on sliders and hinges of 1 kg or 1 kg m^2 without gravity."""

import math
from collections.abc import Callable, Sequence
from typing import Any

import newton
import numpy as np
import warp as wp
from newton import JointTargetMode

from newton_avbd.study.properties.property import DT, Catalog, Measure, Trial, after

G = 9.81
"""Gravity where there is any [m/s^2], along -z."""

JOINTS = Catalog()
"""Properties of joints by name."""

_FRICTION = {"steel": {"enable_joint_friction": True}}
_VELOCITY_LIMIT = {"steel": {"enable_joint_velocity_limits": True}}
_COMPLIANT = {"avbd": {"compliant_contacts": True}}


def add_link(builder: newton.ModelBuilder, inertia: float = 1.0) -> int:
    """Add a body of 1 kg with the same moment of inertia about all axes [kg m^2]."""
    return builder.add_link(mass=1.0, inertia=wp.mat33(inertia * np.eye(3)))


def frame(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> wp.transform:
    """A frame that is shifted [m]."""
    return wp.transform(wp.vec3(x, y, z), wp.quat_identity())


def weightless(builder: newton.ModelBuilder) -> None:
    """Switch gravity off."""
    builder.gravity = (0.0, 0.0, 0.0)


def add_slider(
    builder: newton.ModelBuilder, q: float = 0.0, qd: float = 0.0, axis: Any = (1, 0, 0), **dof: Any
) -> int:
    """Add a slider on the world along an axis, at q [m] with qd [m/s]; returns its joint."""
    joint = builder.add_joint_prismatic(-1, add_link(builder), axis=axis, **dof)
    builder.joint_q[-1], builder.joint_qd[-1] = q, qd
    builder.add_articulation([joint])
    return joint


def add_hinge(builder: newton.ModelBuilder, q: float = 0.0, qd: float = 0.0, **dof: Any) -> int:
    """Add a hinge on the world about y through a body's center, at q [rad] with qd [rad/s]."""
    joint = builder.add_joint_revolute(-1, add_link(builder), axis=(0.0, 1.0, 0.0), **dof)
    builder.joint_q[-1], builder.joint_qd[-1] = q, qd
    builder.add_articulation([joint])
    return joint


def moved(seconds: float, force: float = 0.0, component: int = 0) -> Measure:
    """Measure of how far the first body has come along an axis after a time under a joint force."""
    return after(seconds, lambda trial: trial.center()[component], drive=force)


@JOINTS.declare(
    "joint_friction: holds",
    "A slider with 2 N of friction, pushed by 1.5 N for 0.5 s, stays.",
    expected=0.0,
    bound=1.0e-4,
    unit="m",
    settings=_FRICTION,
)
def _(builder: newton.ModelBuilder, authored: bool) -> Measure:
    weightless(builder)
    add_slider(builder, friction=2.0 if authored else 0.0)
    return moved(0.5, 1.5)


@JOINTS.declare(
    "joint_friction: moves",
    "The same, pushed by 3 N: it moves by (F - 2 N) t^2 / 2m.",
    expected=0.125,
    bound=0.02 * 0.125,
    unit="m",
    settings=_FRICTION,
)
def _(builder: newton.ModelBuilder, authored: bool) -> Measure:
    weightless(builder)
    add_slider(builder, friction=2.0 if authored else 0.0)
    return moved(0.5, 3.0)


@JOINTS.declare(
    "joint_friction: slows down",
    "A hinge with 2 N m of friction, turning at 2 rad/s, stops after I w^2 / 2 tau.",
    expected=1.0,
    bound=0.02,
    unit="rad",
    settings=_FRICTION,
)
def _(builder: newton.ModelBuilder, authored: bool) -> Measure:
    weightless(builder)
    add_hinge(builder, qd=2.0, friction=2.0 if authored else 0.0)
    return after(1.4, Trial.turn)


@JOINTS.declare(
    "joint_damping",
    "A slider with 2 N s/m, started at 1 m/s: after 0.5 s it has exp(-c t / m).",
    expected=math.exp(-1.0),
    bound=0.02 * math.exp(-1.0),
    unit="m/s",
)
def _(builder: newton.ModelBuilder, authored: bool) -> Measure:
    weightless(builder)
    add_slider(builder, qd=1.0, damping=2.0 if authored else 0.0)
    return after(0.5, lambda trial: trial.velocity()[0])


@JOINTS.declare(
    "joint_stiffness, joint_rest_q",
    "A slider on a spring of 25 N/m that rests at 0.2 m, let go at 0: "
    "after half a period it is at 0.4 m.",
    expected=0.4,
    bound=0.02 * 0.4,
    unit="m",
)
def _(builder: newton.ModelBuilder, authored: bool) -> Measure:
    weightless(builder)
    add_slider(builder, **({"stiffness": 25.0, "rest_q": 0.2} if authored else {}))
    return moved(math.pi / 5.0)


@JOINTS.declare(
    "joint_armature",
    "A hinge of 1 kg m^2 and 3 kg m^2 of armature on a drive of 100 N m/rad, let go: "
    "it passes its target after a quarter of the period 2 pi sqrt((I + a) / ke).",
    expected=0.25 * math.tau / 5.0,
    bound=0.02 * 0.25 * math.tau / 5.0,
    unit="s",
)
def _(builder: newton.ModelBuilder, authored: bool) -> Measure:
    weightless(builder)
    add_hinge(builder, q=0.1, target_ke=100.0, target_q=0.0, armature=3.0 if authored else 0.0)
    return lambda trial: trial.moment(trial.turn, 1.0)


@JOINTS.declare(
    "joint_effort_limit",
    "A slider whose drive of 1000 N/m is 1 m off, limited to 2 N: it moves by F t^2 / 2m.",
    expected=0.25,
    bound=0.02 * 0.25,
    unit="m",
)
def _(builder: newton.ModelBuilder, authored: bool) -> Measure:
    weightless(builder)
    add_driven_slider(builder, authored)
    return moved(0.5)


def add_driven_slider(builder: newton.ModelBuilder, limited: bool) -> None:
    """Add a slider whose drive is 1 m off its target, limited to 2 N or not."""
    limit = {"effort_limit": 2.0} if limited else {}
    add_slider(builder, target_ke=1000.0, target_kd=50.0, target_q=1.0, **limit)


@JOINTS.declare(
    "joint_effort_limit: no chatter",
    "The same: in each step the force is 2 N; the one that is furthest off.",
    expected=2.0,
    bound=0.02,
    unit="N",
)
def _(builder: newton.ModelBuilder, authored: bool) -> Measure:
    weightless(builder)
    add_driven_slider(builder, authored)

    def measure(trial: Trial) -> float:
        speeds = [0.0, *(trial.velocity()[0] for _ in trial.steps(0.3))]
        return max(np.diff(speeds) / DT, key=lambda force: abs(force - 2.0))

    return measure


@JOINTS.declare(
    "joint_velocity_limit",
    "A slider limited to 1 m/s, pushed by 10 N: after 0.5 s it has 1 m/s.",
    expected=1.0,
    bound=1.0e-3,
    unit="m/s",
    settings=_VELOCITY_LIMIT,
)
def _(builder: newton.ModelBuilder, authored: bool) -> Measure:
    weightless(builder)
    add_slider(builder, **({"velocity_limit": 1.0} if authored else {}))
    return after(0.5, lambda trial: trial.velocity()[0], drive=10.0)


def in_mode(
    mode: JointTargetMode, otherwise: JointTargetMode | None, q: float, qd: float, force: float
) -> Any:
    """Builder of a slider whose drive has ke 25 N/m and kd 4 N s/m in a mode.

    ``otherwise`` is the mode without the property; None for no gains at all.
    """

    def build(builder: newton.ModelBuilder, authored: bool) -> Measure:
        weightless(builder)
        drive = {"target_ke": 25.0, "target_kd": 4.0, "target_q": q, "target_qd": qd}
        if not authored and otherwise is None:
            drive = {}
        chosen = mode if authored else otherwise
        add_slider(builder, actuator_mode=chosen, **drive)
        return moved(0.4, force)

    return build


def _approach(goal: float, start_speed: float, seconds: float) -> float:
    """Where a slider is that a drive of 25 N/m and 4 N s/m takes from 0 to its goal [m]."""
    frequency = math.sqrt(25.0 - 2.0**2)
    decay = math.exp(-2.0 * seconds)
    sine, cosine = math.sin(frequency * seconds), math.cos(frequency * seconds)
    part = goal * (cosine + 2.0 / frequency * sine) - start_speed / frequency * sine
    return goal - decay * part


_FOLLOWS = 0.5 * (0.4 - (1.0 - math.exp(-4.0 * 0.4)) / 4.0)
_REACHES = _approach(0.2, 0.0, 0.4)
_TRACKS = _approach(0.2 + 4.0 * 0.5 / 25.0, 0.0, 0.4)
_BOTH = JointTargetMode.POSITION_VELOCITY

for _mode, _otherwise, _q, _qd, _force, _closed_form, _text in (
    (JointTargetMode.NONE, _BOTH, 0.2, 0.5, 0.0, 0.0, "it stays"),
    (JointTargetMode.POSITION, None, 0.2, 0.0, 0.0, _REACHES, "it approaches 0.2 m"),
    (JointTargetMode.VELOCITY, _BOTH, 0.2, 0.5, 0.0, _FOLLOWS, "kd alone takes it to 0.5 m/s"),
    (_BOTH, None, 0.2, 0.5, 0.0, _TRACKS, "it approaches 0.2 m + kd 0.5 m/s / ke"),
    (JointTargetMode.EFFORT, _BOTH, 0.2, 0.5, 1.0, 0.08, "only joint_f = 1 N moves it"),
):
    JOINTS.declare(
        f"joint_target_mode: {_mode.name}",
        f"A slider with ke 25 N/m, kd 4 N s/m, targets {_q:g} m and {_qd:g} m/s: {_text}.",
        expected=_closed_form,
        bound=0.02 * _closed_form if _closed_form else 1.0e-5,
        unit="m",
    )(in_mode(_mode, _otherwise, _q, _qd, _force))


def falling(**limits: float) -> Any:
    """Builder of a vertical slider with limits."""

    def build(builder: newton.ModelBuilder, authored: bool) -> None:
        add_slider(builder, axis=(0.0, 0.0, 1.0), **(limits if authored else {}))

    return build


@JOINTS.declare(
    "joint limit: stops",
    "A slider that falls on its lower limit at -0.1 m: the lowest that it ever comes.",
    expected=-0.1,
    bound=1.0e-3,
    unit="m",
)
def _(builder: newton.ModelBuilder, authored: bool) -> Measure:
    falling(limit_lower=-0.1)(builder, authored)
    return lambda trial: min(trial.center()[2] for _ in trial.steps(1.0))


@JOINTS.declare("joint limit: holds", "The same after 1 s.", expected=-0.1, bound=1.0e-4, unit="m")
def _(builder: newton.ModelBuilder, authored: bool) -> Measure:
    falling(limit_lower=-0.1)(builder, authored)
    return moved(1.0, component=2)


@JOINTS.declare(
    "joint limit: compliant",
    "A slider that rests on a limit at 0 with limit_ke 400 N/m, limit_kd 40 N s/m: -m g / ke.",
    expected=-G / 400.0,
    bound=0.02 * G / 400.0,
    unit="m",
    settings=_COMPLIANT,
)
def _(builder: newton.ModelBuilder, authored: bool) -> Measure:
    softness = {"limit_ke": 400.0, "limit_kd": 40.0} if authored else {}
    falling(limit_lower=0.0, **softness)(builder, True)
    return moved(1.5, component=2)


OFFSET, RATIO = 0.1, 2.0
"""What mimic joints add to the coordinate of their leader, and by what they multiply it."""


def mimicking(kind: str) -> Any:
    """Builder of a leader and a follower, which is pushed; measures how far they disagree."""

    def build(builder: newton.ModelBuilder, authored: bool) -> Measure:
        add_pair(builder, kind, authored)

        def error(trial: Trial) -> float:
            leader, follower = coordinates(trial, kind, 0), coordinates(trial, kind, 1)
            return float(np.max(np.abs(follower - OFFSET - RATIO * leader)))

        def measure(trial: Trial) -> float:
            dofs = trial.model.joint_dof_count // 2
            for dof in range(dofs):
                trial.drive(2.0, dofs + dof)
            return max(error(trial) for _ in trial.steps(0.5))

        return measure

    return build


def add_pair(builder: newton.ModelBuilder, kind: str, mimic: bool) -> None:
    """Add two joints on the world of 1 kg and 1 kg m^2, the second of which mimics the first."""
    weightless(builder)
    dof = newton.ModelBuilder.JointDofConfig
    joints = []
    for _ in range(2):
        link = add_link(builder)
        if kind == "PRISMATIC":
            joint = builder.add_joint_prismatic(-1, link, axis=(1.0, 0.0, 0.0))
        elif kind == "REVOLUTE":
            joint = builder.add_joint_revolute(-1, link, axis=(0.0, 1.0, 0.0))
        else:
            axes = {"linear_axes": [dof(axis=(1, 0, 0))], "angular_axes": [dof(axis=(0, 1, 0))]}
            joint = builder.add_joint_d6(-1, link, **axes)
        joints.append(joint)
    builder.add_articulation(joints)
    half = len(builder.joint_q) // 2
    builder.joint_q[half:] = [OFFSET] * half
    if mimic:
        builder.set_joint_mimic(joints[1], joints[0], coeffs=(OFFSET, RATIO))


def coordinates(trial: Trial, kind: str, body: int) -> np.ndarray:
    """Coordinates of one of the two joints, read off its body."""
    x, angle = trial.center(body)[0], trial.turn(body)
    return np.array({"PRISMATIC": [x], "REVOLUTE": [angle], "D6": [x, angle]}[kind])


for _kind in ("PRISMATIC", "REVOLUTE", "D6"):
    JOINTS.declare(
        f"mimic: {_kind}",
        "Of two such joints the second mimics the first, q2 = 0.1 + 2 q1, and is pushed: "
        "the largest q2 - 0.1 - 2 q1.",
        expected=0.0,
        bound=1.0e-5,
        unit="m, rad",
    )(mimicking(_kind))


@JOINTS.declare(
    "mimic: both ways",
    "Two sliders, q2 = 0.1 + 2 q1, 2 N on the second: the first moves by 2 F t^2 / 2 (m + 4 m).",
    expected=0.1,
    bound=0.02 * 0.1,
    unit="m",
)
def _(builder: newton.ModelBuilder, authored: bool) -> Measure:
    add_pair(builder, "PRISMATIC", authored)
    return after(0.5, lambda trial: trial.center()[0], drive=2.0, dof=1)


def quarter_period(inertia: float, torque: float, angle: float = 0.1) -> float:
    """Quarter of the period of a pendulum [s].

    Args:
        inertia: Moment of inertia about the pivot [kg m^2].
        torque: Torque that turns it back, by the sine of its angle [N m].
        angle: Angle at which it is let go [rad].
    """
    return 0.25 * math.tau * math.sqrt(inertia / torque) * (1.0 + angle**2 / 16.0)


ARM, SPIN_INERTIA = 0.5, 0.01
"""Distance of a pendulum's center from its pivot [m], inertia about its center [kg m^2]."""

SWING = quarter_period(SPIN_INERTIA + ARM**2, G * ARM)
"""Quarter of the period of a pendulum of 1 kg let go at 0.1 rad [s]."""


def passes_bottom(trial: Trial) -> float:
    """When the first body passes below its pivot [s]."""
    return trial.moment(lambda: trial.center()[0], 1.5)


@JOINTS.declare(
    "loop: MuJoCo CONNECT",
    "A body with a free joint, held to the world at 0.5 m from its center by `connect`: "
    "a pendulum; a quarter of its period.",
    expected=SWING,
    bound=0.01 * SWING,
    unit="s",
)
def _(builder: newton.ModelBuilder, authored: bool) -> Measure:
    x, z = ARM * math.sin(0.1), -ARM * math.cos(0.1)
    connect = f'<equality><connect body1="bob" anchor="{-x} 0 {-z}"/></equality>'
    builder.add_mjcf(
        f"""<mujoco><worldbody><body name="bob" pos="{x} 0 {z}"><freejoint/>
        <inertial pos="0 0 0" mass="1" diaginertia="{SPIN_INERTIA} {SPIN_INERTIA} {SPIN_INERTIA}"/>
        </body></worldbody>{connect if authored else ""}</mujoco>"""
    )
    return passes_bottom


@JOINTS.declare(
    "loop: MuJoCo WELD",
    "A free body of 1 kg, held by `weld` beside a slider of 1 kg that 2 N push: F t^2 / 2 (2 m).",
    expected=0.125,
    bound=0.02 * 0.125,
    unit="m",
)
def _(builder: newton.ModelBuilder, authored: bool) -> Measure:
    inertial = '<inertial pos="0 0 0" mass="1" diaginertia="0.1 0.1 0.1"/>'
    weld = '<equality><weld body1="load" body2="sled"/></equality>'
    builder.add_mjcf(
        f"""<mujoco><option gravity="0 0 0"/><worldbody>
        <body name="sled"><joint type="slide" axis="1 0 0"/>{inertial}</body>
        <body name="load" pos="0 0.3 0"><freejoint/>{inertial}</body>
        </worldbody>{weld if authored else ""}</mujoco>"""
    )
    weightless(builder)
    return after(0.5, lambda trial: trial.center(1)[0], drive=2.0)


@JOINTS.declare(
    "loop: parallelogram",
    "A bar of 1 kg hangs on two arms of 1 kg and 0.5 m, the last hinge closes a loop: a quarter of "
    "its period, as of a pendulum with inertia (2 m / 3 + m) L^2 and torque 2 m g L.",
    expected=quarter_period((2.0 / 3.0 + 1.0) * ARM**2, 2.0 * G * ARM),
    bound=0.01 * quarter_period((2.0 / 3.0 + 1.0) * ARM**2, 2.0 * G * ARM),
    unit="s",
)
def _(builder: newton.ModelBuilder, authored: bool) -> Measure:
    y, q, half = (0.0, 1.0, 0.0), 0.1, 0.5 * ARM
    arm, bar, other = (add_link(builder, ARM**2 / 12.0) for _ in range(3))
    hinge = builder.add_joint_revolute
    top, low, side = frame(z=half), frame(z=-half), frame(x=-0.5)
    tree = [
        hinge(-1, arm, child_xform=top, axis=y),
        hinge(arm, bar, parent_xform=low, child_xform=side, axis=y),
        hinge(-1, other, parent_xform=frame(x=1.0), child_xform=top, axis=y),
    ]
    builder.add_articulation(tree)
    builder.joint_q[:] = [q, -q, q]
    if authored:
        hinge(bar, other, parent_xform=frame(x=0.5), child_xform=low, axis=y)
        builder.joint_q[-1] = q
    return lambda trial: trial.moment(trial.turn, 1.5)


def breaking(kind: str) -> Callable[[newton.ModelBuilder, bool], Measure]:
    """Builder of a body fixed to the world; measures the load at which it comes off.

    ``kind`` is ``"force"`` or ``"torque"``. The limit is an attribute of SolverAVBD's own.
    """

    def build(builder: newton.ModelBuilder, authored: bool) -> Measure:
        from newton_avbd import SolverAVBD

        weightless(builder)
        SolverAVBD.register_custom_attributes(builder)
        limit = {f"avbd:joint_break_{kind}": 50.0} if authored else {}
        joint = builder.add_joint_fixed(-1, add_link(builder), custom_attributes=limit)
        builder.add_articulation([joint])

        def measure(trial: Trial) -> float:
            for index in range(360):
                load = (0.0, 0.2 * index, 0.0)
                trial.push(**{kind: load})  # type: ignore[arg-type]
                trial.step()
                if np.abs(trial.velocity()).max() > 0.1:
                    return 0.2 * index
            return math.inf

        return measure

    return build


for _kind, _unit in (("force", "N"), ("torque", "N m")):
    JOINTS.declare(
        f"joint breaking: {_kind}",
        f"A body is fixed by a joint that breaks at 50 {_unit} (`avbd:joint_break_{_kind}`, which "
        f"is SolverAVBD's own); the load grows by 48 {_unit}/s: the load at which it comes off.",
        expected=50.0,
        bound=1.0,
        unit=_unit,
    )(breaking(_kind))


def hang(builder: newton.ModelBuilder, authored: bool, kind: str, **settings: Any) -> int:
    """Add a body of 1 kg on a joint of a kind to the world, or on a FREE joint if not authored.

    ``settings`` go to the joint, except for ``inertia`` [kg m^2].
    """
    link = add_link(builder, settings.pop("inertia", SPIN_INERTIA))
    if authored:
        joint = getattr(builder, f"add_joint_{kind}")(-1, link, **settings)
    else:
        joint = builder.add_joint_free(link)
    builder.add_articulation([joint])
    return joint


def place(builder: newton.ModelBuilder, position: Sequence[float], angle: float = 0.0) -> None:
    """Set the coordinates of the last joint, one with seven: a position [m], a turn about y."""
    turn = [0.0, math.sin(0.5 * angle), 0.0, math.cos(0.5 * angle)]
    builder.joint_q[-7:] = [*position, *turn]


@JOINTS.declare(
    "FIXED",
    "A free body of 1 kg, pushed by 2 N, with another fixed to it: both move by F t^2 / 2 (2 m).",
    expected=0.125,
    bound=0.02 * 0.125,
    unit="m",
)
def _(builder: newton.ModelBuilder, authored: bool) -> Measure:
    weightless(builder)
    base, load = add_link(builder), add_link(builder)
    joints = [builder.add_joint_free(base)]
    if authored:
        joints.append(builder.add_joint_fixed(base, load, parent_xform=frame(x=0.5)))
        builder.add_articulation(joints)
    else:
        builder.add_articulation(joints)
        builder.add_articulation([builder.add_joint_free(load)])
        place(builder, (0.5, 0.0, 0.0))
    return after(0.5, lambda trial: trial.center(1)[0] - 0.5, push=(2.0, 0.0, 0.0))


@JOINTS.declare(
    "REVOLUTE", "A pendulum: a quarter of its period.", expected=SWING, bound=0.01 * SWING, unit="s"
)
def _(builder: newton.ModelBuilder, authored: bool) -> Measure:
    settings = {"axis": (0.0, 1.0, 0.0), "child_xform": frame(z=ARM)}
    hang(builder, authored, "revolute", **settings)
    if authored:
        builder.joint_q[-1] = -0.1
    else:
        place(builder, (ARM * math.sin(0.1), 0.0, -ARM * math.cos(0.1)))
    return passes_bottom


@JOINTS.declare(
    "PRISMATIC",
    "A body slides down at 30 degrees: after 0.5 s it is at x = g sin a cos a t^2 / 2.",
    expected=0.125 * G * 0.25 * math.sqrt(3.0),
    bound=0.02 * 0.125 * G * 0.25 * math.sqrt(3.0),
    unit="m",
)
def _(builder: newton.ModelBuilder, authored: bool) -> Measure:
    tilt = wp.quat_from_axis_angle(wp.vec3(0.0, 1.0, 0.0), math.pi / 6.0)
    slope = wp.transform(wp.vec3(0.0, 0.0, 0.0), tilt)
    settings = {"axis": (1.0, 0.0, 0.0), "parent_xform": slope, "child_xform": slope}
    hang(builder, authored, "prismatic", **settings)
    return moved(0.5)


_CONE = math.sqrt(G / (ARM * math.cos(0.3)))


@JOINTS.declare(
    "BALL",
    "A conical pendulum at 0.3 rad: a quarter of its round, at sqrt(g / (d cos a)).",
    expected=0.25 * math.tau / _CONE,
    bound=0.01 * 0.25 * math.tau / _CONE,
    unit="s",
)
def _(builder: newton.ModelBuilder, authored: bool) -> Measure:
    hang(builder, authored, "ball", child_xform=frame(z=ARM))
    if authored:
        builder.joint_q[-4:] = [0.0, math.sin(-0.15), 0.0, math.cos(-0.15)]
        builder.joint_qd[-3:] = [0.0, 0.0, _CONE]
    else:
        place(builder, (ARM * math.sin(0.3), 0.0, -ARM * math.cos(0.3)))
    return passes_bottom


def gantry(builder: newton.ModelBuilder, authored: bool, angle: float) -> None:
    """Add a body that hangs 0.1 m below a slide along x, about which it turns around y."""
    dof = newton.ModelBuilder.JointDofConfig
    hang(
        builder,
        authored,
        "d6",
        inertia=0.1,
        child_xform=frame(z=0.1),
        linear_axes=[dof(axis=(1, 0, 0))],
        angular_axes=[dof(axis=(0, 1, 0))],
    )
    if authored:
        builder.joint_q[-1] = angle
    else:
        place(builder, (0.0, 0.0, -0.1), angle)


@JOINTS.declare(
    "D6: free axes",
    "A body hangs 0.1 m below a slide along x: its center falls straight down; a quarter of the "
    "period of its turns, 2 pi sqrt(I / m g d).",
    expected=quarter_period(0.1, G * 0.1),
    bound=0.01 * quarter_period(0.1, G * 0.1),
    unit="s",
)
def _(builder: newton.ModelBuilder, authored: bool) -> Measure:
    gantry(builder, authored, 0.1)
    return lambda trial: trial.moment(trial.turn, 1.0)


@JOINTS.declare(
    "D6: locked axes",
    "The same, pushed across its slide by 3 N for 0.5 s: it does not move there.",
    expected=0.0,
    bound=1.0e-4,
    unit="m",
)
def _(builder: newton.ModelBuilder, authored: bool) -> Measure:
    gantry(builder, authored, 0.0)
    return after(0.5, lambda trial: trial.center()[1], push=(0.0, 3.0, 0.0))


@JOINTS.declare(
    "DISTANCE",
    "A body falls from 0.3 m below its anchor into a rope of 0.5 m: the lowest that it ever comes.",
    expected=-0.5,
    bound=1.0e-3,
    unit="m",
)
def _(builder: newton.ModelBuilder, authored: bool) -> Measure:
    hang(builder, authored, "distance", **({"max_distance": 0.5} if authored else {}))
    place(builder, (0.0, 0.0, -0.3))
    return lambda trial: min(trial.center()[2] for _ in trial.steps(1.0))


@JOINTS.declare(
    "ROD",
    "A body hangs on a rod along z with 1000 N/m and 50 N s/m of stretch: -m g / k.",
    expected=-G / 1000.0,
    bound=0.02 * G / 1000.0,
    unit="m",
)
def _(builder: newton.ModelBuilder, authored: bool) -> Measure:
    hang(builder, authored, "rod", stretch_stiffness=1000.0, stretch_damping=50.0)
    return moved(1.0, component=2)


@JOINTS.declare(
    "vbd:dahl_eps_max, dahl_tau",
    "A rod with 100 N m/rad is bent by 20 N m and let go slowly; its Dahl friction has 0.05 rad, "
    "and a tau of 0.01 rad, far less than it was bent: 0.05 rad are left.",
    expected=0.05,
    bound=0.001,
    unit="rad",
)
def _(builder: newton.ModelBuilder, authored: bool) -> Measure:
    weightless(builder)
    newton.solvers.SolverVBD.register_custom_attributes(builder)
    joint = hang(builder, True, "rod", bend_stiffness=100.0, bend_damping=5.0, inertia=0.1)
    values = {"dahl_eps_max": 0.05 if authored else 0.0, "dahl_tau": 0.01}
    for name, value in values.items():
        builder.custom_attributes[f"vbd:{name}"].values = {joint: value}

    def measure(trial: Trial) -> float:
        for start, goal in ((0.0, 20.0), (20.0, 0.0)):
            for time in trial.steps(1.0):
                torque = start + min(2.0 * time, 1.0) * (goal - start)
                trial.push(torque=(torque, 0.0, 0.0))
        return trial.turn(axis=0)

    return measure


@JOINTS.declare(
    "joint_f: slider, reaction",
    "1 N between a free base of 1 kg and a slider of 1 kg: the base goes back by F t^2 / 2m.",
    expected=-0.125,
    bound=0.02 * 0.125,
    unit="m",
)
def _(builder: newton.ModelBuilder, authored: bool) -> Measure:
    weightless(builder)
    base, load = add_link(builder), add_link(builder)
    free = builder.add_joint_free(base)
    builder.add_articulation([free, builder.add_joint_prismatic(base, load, axis=(1.0, 0.0, 0.0))])
    return after(0.5, lambda trial: trial.center()[0], drive=1.0 if authored else 0.0, dof=6)


@JOINTS.declare(
    "joint_f: hinge",
    "2 N m on a hinge of 1 kg m^2: it turns by tau t^2 / 2I.",
    expected=0.25,
    bound=0.02 * 0.25,
    unit="rad",
)
def _(builder: newton.ModelBuilder, authored: bool) -> Measure:
    weightless(builder)
    add_hinge(builder)
    return after(0.5, Trial.turn, drive=2.0 if authored else 0.0)


@JOINTS.declare(
    "joint_f: ball",
    "2 N m on the first axis of a ball joint whose parent frame has turned x to y: "
    "it turns about y by tau t^2 / 2I.",
    expected=0.25,
    bound=0.02 * 0.25,
    unit="rad",
)
def _(builder: newton.ModelBuilder, authored: bool) -> Measure:
    weightless(builder)
    quarter = wp.quat_from_axis_angle(wp.vec3(0.0, 0.0, 1.0), 0.5 * math.pi)
    turned = wp.transform(wp.vec3(0.0, 0.0, 0.0), quarter)
    hang(builder, True, "ball", inertia=1.0, parent_xform=turned, child_xform=turned)
    return after(0.5, Trial.turn, drive=2.0 if authored else 0.0)

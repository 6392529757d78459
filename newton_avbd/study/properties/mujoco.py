# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""What the namespace ``mujoco`` authors: properties that are tried, and all attributes."""

from collections.abc import Callable
from fnmatch import fnmatchcase

import newton
from newton.solvers import SolverMuJoCo
from numpy.polynomial import Polynomial

from newton_avbd.study.properties.property import Catalog, Measure, Trial, after

G = 9.81
"""Gravity [m/s^2], along -z."""
R = 0.1
"""Radius of spheres and half an edge of boxes [m]."""
SECONDS = 0.25
CURVE = (0.1, 0.5, 0.8, -0.6, 0.7)
"""Coefficients of a polynomial, from the constant one."""

MUJOCO = Catalog()
"""Properties by name."""


def read(builder: newton.ModelBuilder, text: str) -> None:
    """Add what an MJCF text says, with what its attributes author."""
    SolverMuJoCo.register_custom_attributes(builder)
    builder.add_mjcf(text, ctrl_direct=True)


def on_floor(kind: str, floor: str, geom: str, contact: str = "") -> str:
    """A body on a plane; both geoms have friction, and other attributes."""
    return f"""<mujoco><worldbody>
      <geom name="floor" type="plane" size="5 5 .1" friction="0.3 0.01 0.002" {floor}/>
      <body pos="0 0 {R}"><freejoint/><geom name="geom" type="{kind}" size="{R} {R} {R}"
        friction="0.7 0.02 0.004" {geom}/></body></worldbody>
      <contact>{contact}</contact></mujoco>"""


def slowed(
    motion: str, authored: str, plain: str
) -> Callable[[newton.ModelBuilder, bool], Measure]:
    """Builder of a body that slides, spins or rolls; what measures is the friction that acts."""
    speed, component, velocity, per_slowing = _MOTIONS[motion]

    def build(builder: newton.ModelBuilder, is_authored: bool) -> Measure:
        read(builder, authored if is_authored else plain)
        builder.joint_qd[-6:] = velocity

        return after(
            SECONDS, lambda trial: (speed - trial.velocity()[component]) / SECONDS * per_slowing
        )

    return build


_MOTIONS: dict[str, tuple[float, int, tuple[float, ...], float]] = {
    "slides": (2.0, 0, (2.0, 0.0, 0.0, 0.0, 0.0, 0.0), 1.0 / G),
    "spins": (30.0, 5, (0.0, 0.0, 0.0, 0.0, 0.0, 30.0), 0.4 * R * R / G),
    "rolls": (2.0, 0, (2.0, 0.0, 0.0, 0.0, 2.0 / R, 0.0), 1.4 * R / G),
}
"""Speed at the start, the component that it is, the whole velocity, and friction by slowing."""
_PLAIN = on_floor("box", "", "")
_BALL = on_floor("sphere", "", "")
_FREE = on_floor("box", 'condim="1"', 'condim="1"')
_PAIR = '<pair geom1="floor" geom2="geom" friction="0.6 0.6 0 0 0"/>'

MUJOCO.declare(
    "mujoco:condim 1",
    "A box slides at 2 m/s, both geoms with condim 1: the friction that acts.",
    expected=0.0,
    bound=1.0e-3,
)(slowed("slides", _FREE, _PLAIN))

MUJOCO.declare(
    "mujoco:condim 3",
    "A box with friction 0.7 slides at 2 m/s over a floor with 0.3: the larger of the two acts.",
    expected=0.7,
    bound=0.014,
)(slowed("slides", _PLAIN, _FREE))

MUJOCO.declare(
    "mujoco:condim 4",
    "A sphere with torsional friction 0.02 m spins at 30 rad/s: the friction that acts.",
    expected=0.02,
    bound=4.0e-4,
    unit="m",
)(slowed("spins", on_floor("sphere", "", 'condim="4"'), _BALL))

MUJOCO.declare(
    "mujoco:condim 6",
    "A sphere with rolling friction 0.004 m rolls at 2 m/s: the friction that acts.",
    expected=0.004,
    bound=8.0e-5,
    unit="m",
)(slowed("rolls", on_floor("sphere", "", 'condim="6"'), _BALL))

MUJOCO.declare(
    "mujoco:geom_priority",
    "A box with friction 0.7 slides over a floor with 0.3 and a higher priority: 0.3 acts.",
    expected=0.3,
    bound=0.006,
)(slowed("slides", on_floor("box", 'priority="1"', ""), _PLAIN))

MUJOCO.declare(
    "mujoco:pair_friction",
    "The same with an explicit pair of friction 0.6: that acts.",
    expected=0.6,
    bound=0.012,
)(slowed("slides", on_floor("box", "", "", _PAIR), _PLAIN))


def sliders(equality: str) -> str:
    """Two bodies of 1 kg on slides, along z and along x, with an equality constraint."""
    bodies = "".join(
        f"""<body name="{name}" pos="0 {at} 0"><joint name="{name}" type="slide" axis="{axis}"/>
        <geom size=".1" mass="1" contype="0" conaffinity="0"/></body>"""
        for name, at, axis in (("up", 0, "0 0 1"), ("along", 1, "1 0 0"))
    )
    return f"<mujoco><worldbody>{bodies}</worldbody><equality>{equality}</equality></mujoco>"


@MUJOCO.declare(
    "mujoco:equality_constraint_polycoef",
    "A weight on a slide follows another slide by a polynomial of the fourth degree, and pulls it "
    "along: the largest that it is off in 0.5 s.",
    expected=0.0,
    bound=1.0e-4,
    unit="m",
)
def _(builder: newton.ModelBuilder, authored: bool) -> Measure:
    curve = " ".join(map(str, CURVE))
    read(builder, sliders(f'<joint joint1="up" joint2="along" polycoef="{curve}"/>' * authored))
    follows = Polynomial(CURVE)
    builder.joint_q[:] = [follows(0.4), 0.4]

    def measure(trial: Trial) -> float:
        return max(abs(trial.center(0)[2] - follows(trial.center(1)[0])) for _ in trial.steps(0.5))

    return measure


@MUJOCO.declare(
    "mujoco:equality_constraint: held",
    "An equality constraint without a second joint holds a weight on a slide.",
    expected=0.0,
    bound=1.0e-4,
    unit="m",
)
def _(builder: newton.ModelBuilder, authored: bool) -> Measure:
    read(builder, sliders('<joint joint1="up" polycoef="0"/>' * authored))
    return after(0.5, lambda trial: trial.center(0)[2])


@MUJOCO.declare(
    "mujoco:gravcomp",
    "A free body whose weight is compensated by half falls by g t^2 / 4.",
    expected=-0.25 * G * 0.25,
    bound=0.01 * 0.25 * G,
    unit="m",
)
def _(builder: newton.ModelBuilder, authored: bool) -> Measure:
    gravcomp = 'gravcomp="0.5"' if authored else ""
    body = f'<body {gravcomp}><freejoint/><geom size=".1" mass="1"/></body>'
    read(builder, f"<mujoco><worldbody>{body}</worldbody></mujoco>")
    return after(0.5, lambda trial: trial.center()[2])


ATTRIBUTES: dict[str, tuple[str, str]] = {
    "condim": ("acts", "`mujoco:condim 1` to `6`"),
    "geom_priority": ("acts", "`mujoco:geom_priority`"),
    "pair_geom[12]": ("acts where Newton's pipeline makes contacts; else a warning", "tests"),
    "pair_world": ("names the world", ""),
    "pair_friction": ("acts, the mean of two directions with a warning", "`mujoco:pair_friction`"),
    "pair_condim": ("acts", "tests"),
    "pair_margin": ("acts; contacts come within the shapes' own margin and gap", "tests"),
    "pair_gap": ("ignored: what detection needs is the shapes' gap", ""),
    "pair_sol*": ("ignored: contacts are rigid, MuJoCo's are soft by it", ""),
    "contype": ("acts by Newton's importer: collision groups and filters", "Newton's"),
    "conaffinity": ("acts by Newton's importer: collision groups and filters", "Newton's"),
    "collision_mask_domain": ("says which shapes are of an MJCF file", "tests"),
    "solref": ("ignored: contacts are rigid; with `compliant_contacts`, `ke` and `kd` act", ""),
    "solref_mode": ("ignored, as `solref`", ""),
    "geom_solimp": ("ignored, as `solref`", ""),
    "geom_solmix": ("ignored: it weighs `solref` and `solimp`", ""),
    "geom_group": ("ignored: for display", ""),
    "hfield_base": ("ignored: for export", ""),
    "site_size_is_display": ("ignored: for display", ""),
    "gravcomp": ("acts", "`mujoco:gravcomp`"),
    "jnt_actgravcomp": ("acts: the compensation counts towards the limit of the axis", "tests"),
    "dof_passive_stiffness": ("acts: Newton writes it to `joint_stiffness`", "`joint_stiffness`"),
    "dof_springref": ("acts: Newton writes it to `joint_rest_q`", "`joint_stiffness`"),
    "dof_ref": ("acts on lengths of actuators and tendons, and in equalities", "tests"),
    "limit_margin": ("acts: a limit holds where its margin begins", "tests"),
    "solreflimit*": ("acts with `compliant_contacts`; else ignored: limits are rigid", "tests"),
    "solimplimit": ("acts or is ignored as `solreflimit`", "tests"),
    "solreffriction": ("ignored: friction holds without creep", ""),
    "solimpfriction": ("ignored, as `solreffriction`", ""),
    "joint_dof_label": ("names things", ""),
    "sleep_policy": ("ignored: see `sleeping`", ""),
    "sleep_tolerance": ("ignored: see `sleeping`", ""),
    "enable_sleeping": ("ignored: see `sleeping`", ""),
    "density": ("acts", "`mujoco:density, wind`"),
    "wind": ("acts", "`mujoco:density, wind`"),
    "viscosity": ("acts", "`mujoco:viscosity`"),
    "magnetic": ("ignored: of sensors", ""),
    "impratio": ("ignored: of MuJoCo's soft friction", ""),
    "iterations": ("ignored: of MuJoCo's solver", ""),
    "tolerance": ("ignored: of MuJoCo's solver", ""),
    "ls_*": ("ignored: of MuJoCo's solver", ""),
    "ccd_*": ("ignored: of MuJoCo's collision detection", ""),
    "sdf_*": ("ignored: of MuJoCo's collision detection", ""),
    "integrator": ("ignored: for RK4 pass `scheme='runge_kutta'`", ""),
    "solver": ("ignored: of MuJoCo's solver", ""),
    "cone": ("ignored: the cone is round", ""),
    "jacobian": ("ignored: of MuJoCo's solver", ""),
    "flag_*": ("ignored; a warning where one turns physics off: leave out the effect", "tests"),
    "equality_constraint_polycoef": ("acts", "`mujoco:equality_constraint_polycoef`"),
    "equality_constraint_joint[12]*": ("acts", "`mujoco:equality_constraint: held`, tests"),
    "equality_constraint_tendon[12]": ("acts", "tests"),
    "equality_constraint_torquescale": (
        "0 leaves the rotation free; scales what gives way (`eq_solref`); else ignored: welds are "
        "rigid",
        "tests",
    ),
    "equality_constraint_*": (
        "acts, by the joint or mimic that Newton's importer makes of it, or without one",
        "`loop: MuJoCo CONNECT`, `loop: MuJoCo WELD`",
    ),
    "eq_sol*": (
        "acts on CONNECT and WELD to links that only the user moves, such as mocap bodies; else "
        "ignored: joints are rigid",
        "tests",
    ),
    "ctrl*": ("acts", "tests"),
    "autolimits": ("acts", "tests"),
    "actuator_world": ("names things", ""),
    "actuator_articulation": ("names things", ""),
    "actuator_label": ("names things", ""),
    "actuator_cranklength": ("acts", "tests"),
    "actuator_ctrlspec": ("acts: what the control of a DC motor is", "tests"),
    "actuator_actdim": (
        "ignored: dynamics of the user, or a PID's, are left out with a warning",
        "",
    ),
    "actuator_trn*": (
        "acts at joints, tendons, sites, slider-cranks and bodies (adhesion)",
        "tests",
    ),
    "actuator_gaintype": ("acts; SO3, PID and user are left out with a warning", "tests"),
    "actuator_biastype": ("acts; SO3, PID and user are left out with a warning", "tests"),
    "actuator_dyntype": ("acts; PID and user are left out with a warning", "tests"),
    "actuator_gear": ("acts; 1 where the actuator is a joint drive", "tests"),
    "actuator_*": ("acts", "tests"),
    "tendon_type": ("acts: fixed and spatial ones", "tests"),
    "tendon_joint*": ("acts", "tests"),
    "tendon_coef": ("acts", "tests"),
    "tendon_wrap_*": ("acts", "tests"),
    "tendon_stiffness": ("acts", "tests"),
    "tendon_springlength": ("acts", "tests"),
    "tendon_damping": ("acts", "tests"),
    "tendon_limited": ("acts: rigid, or with compliant_contacts by its impedance", "tests"),
    "tendon_range": ("acts", "tests"),
    "tendon_margin": ("acts: moves the limits", "tests"),
    "tendon_frictionloss": ("acts", "tests"),
    "tendon_armature": ("acts", "tests"),
    "tendon_actuator_force_*": ("acts", "tests"),
    "tendon_sol*_limit*": ("acts with compliant_contacts=True; else limits are rigid", ""),
    "tendon_label": ("names things", ""),
    "tendon_world": ("names things", ""),
    "tendon_articulation": ("names things", ""),
    "tendon_*": ("ignored: friction is rigid, and limits give way by solref", ""),
}
"""What SolverAVBD makes of an attribute, and what tries that; by pattern, the first that fits."""


def registered() -> list[str]:
    """Attributes of the installed version, sorted."""
    builder = newton.ModelBuilder()
    SolverMuJoCo.register_custom_attributes(builder)
    keys = sorted(builder.custom_attributes)
    return [key.removeprefix("mujoco:") for key in keys if key.startswith("mujoco:")]


def pattern_of(attribute: str) -> str | None:
    """The pattern of :data:`ATTRIBUTES` that is for an attribute."""
    return next((pattern for pattern in ATTRIBUTES if fnmatchcase(attribute, pattern)), None)

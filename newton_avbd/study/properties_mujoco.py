# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""What the namespace ``mujoco`` authors: properties that are tried, and all attributes."""

from collections.abc import Callable
from fnmatch import fnmatchcase

import newton
from newton.solvers import SolverMuJoCo
from numpy.polynomial import Polynomial

from newton_avbd.study.property import Catalog, Measure, Trial

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


def moving(
    authored: str, plain: str, velocity: tuple[float, ...], component: int
) -> Callable[[newton.ModelBuilder, bool], Measure]:
    """Builder of a body that starts with a velocity; what measures is what is left of it."""

    def build(builder: newton.ModelBuilder, is_authored: bool) -> Measure:
        read(builder, authored if is_authored else plain)
        builder.joint_qd[-6:] = velocity

        def measure(trial: Trial) -> float:
            trial.run(SECONDS)
            return trial.velocity()[component]

        return measure

    return build


_SLIDES = (2.0, 0.0, 0.0, 0.0, 0.0, 0.0)
_SPINS = (0.0, 0.0, 0.0, 0.0, 0.0, 30.0)
_ROLLS = (2.0, 0.0, 0.0, 0.0, 2.0 / R, 0.0)
_PLAIN = on_floor("box", "", "")


def _lost(mu: float) -> float:
    """Speed that sliding takes [m/s]."""
    return mu * G * SECONDS


MUJOCO.declare(
    "mujoco:condim 1",
    "A box slides at 2 m/s, both geoms with condim 1: it keeps its speed.",
    expected=2.0,
    bound=0.002,
    unit="m/s",
)(moving(on_floor("box", 'condim="1"', 'condim="1"'), _PLAIN, _SLIDES, 0))

MUJOCO.declare(
    "mujoco:condim 3",
    "A box slides at 2 m/s, friction 0.7 and 0.3 of the floor: it slows down at 0.7 g, the larger.",
    expected=2.0 - _lost(0.7),
    bound=0.02 * _lost(0.7),
    unit="m/s",
)(moving(_PLAIN, on_floor("box", 'condim="1"', 'condim="1"'), _SLIDES, 0))

MUJOCO.declare(
    "mujoco:condim 4",
    "A sphere spins at 30 rad/s, torsional friction 0.02 m: it slows down at mu g / (2/5 r^2).",
    expected=30.0 - 0.02 * G * SECONDS / (0.4 * R * R),
    bound=0.05 * 0.02 * G * SECONDS / (0.4 * R * R),
    unit="rad/s",
)(moving(on_floor("sphere", "", 'condim="4"'), on_floor("sphere", "", ""), _SPINS, 5))

MUJOCO.declare(
    "mujoco:condim 6",
    "A sphere rolls at 2 m/s, rolling friction 0.004 m: it slows down at mu g / (7/5 r).",
    expected=2.0 - 0.004 * G * SECONDS / (1.4 * R),
    bound=0.05 * 0.004 * G * SECONDS / (1.4 * R),
    unit="m/s",
)(moving(on_floor("sphere", "", 'condim="6"'), on_floor("sphere", "", ""), _ROLLS, 0))

MUJOCO.declare(
    "mujoco:geom_priority",
    "A box slides at 2 m/s, friction 0.7 and 0.3 of the floor of a higher priority: 0.3 g.",
    expected=2.0 - _lost(0.3),
    bound=0.02 * _lost(0.3),
    unit="m/s",
)(moving(on_floor("box", 'priority="1"', ""), _PLAIN, _SLIDES, 0))

MUJOCO.declare(
    "mujoco:pair_friction",
    "A box slides at 2 m/s, an explicit pair says 0.5: 0.5 g.",
    expected=2.0 - _lost(0.5),
    bound=0.02 * _lost(0.5),
    unit="m/s",
)(
    moving(
        on_floor("box", "", "", '<pair geom1="floor" geom2="geom" friction="0.5 0.5 0 0 0"/>'),
        _PLAIN,
        _SLIDES,
        0,
    )
)


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

    def measure(trial: Trial) -> float:
        trial.run(0.5)
        return trial.center(0)[2]

    return measure


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

    def measure(trial: Trial) -> float:
        trial.run(0.5)
        return trial.center()[2]

    return measure


ATTRIBUTES: dict[str, tuple[str, str]] = {
    "condim": ("acts", "`mujoco:condim 1` to `6`"),
    "geom_priority": ("acts", "`mujoco:geom_priority`"),
    "pair_geom[12]": ("act where Newton's pipeline makes contacts; else a warning", "tests"),
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
    "jnt_actgravcomp": ("ignored: matters where a force limit binds", ""),
    "dof_passive_stiffness": ("acts: Newton writes it to `joint_stiffness`", "`joint_stiffness`"),
    "dof_springref": ("acts: Newton writes it to `joint_rest_q`", "`joint_stiffness`"),
    "dof_ref": ("acts on lengths of actuators and tendons, and in equalities", "tests"),
    "limit_margin": ("ignored: a rigid limit pushes at the limit, not before", ""),
    "solreflimit*": ("ignored: limits are rigid; with `compliant_contacts`, `limit_ke` acts", ""),
    "solimplimit": ("ignored, as `solreflimit`", ""),
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
    "integrator": ("ignored: see `scheme`", ""),
    "solver": ("ignored: of MuJoCo's solver", ""),
    "cone": ("ignored: the cone is round", ""),
    "jacobian": ("ignored: of MuJoCo's solver", ""),
    "flag_*": ("ignored; a warning where one turns physics off: leave out the effect", "tests"),
    "equality_constraint_polycoef": ("acts", "`mujoco:equality_constraint_polycoef`"),
    "equality_constraint_joint[12]*": ("act", "`mujoco:equality_constraint: held`, tests"),
    "equality_constraint_tendon[12]": ("left out with a warning", ""),
    "equality_constraint_torquescale": ("ignored: welds are rigid", ""),
    "equality_constraint_*": (
        "acts as the joint or mimic that Newton's importer makes of it; CONNECT and WELD without "
        "one are left out with a warning",
        "`loop: MuJoCo CONNECT`, `loop: MuJoCo WELD`",
    ),
    "eq_sol*": ("ignored: joints are rigid", ""),
    "ctrl*": ("act", "tests"),
    "autolimits": ("acts", "tests"),
    "actuator_world": ("names things", ""),
    "actuator_articulation": ("names things", ""),
    "actuator_label": ("names things", ""),
    "actuator_cranklength": ("ignored: slider-cranks are left out with a warning", ""),
    "actuator_ctrlspec": ("ignored: of DC motors, left out with a warning", ""),
    "actuator_actdim": ("ignored: dynamics of the user are left out with a warning", ""),
    "actuator_*": ("acts; kinds that do not are left out with a warning", "tests"),
    "tendon_type": ("fixed ones act; spatial ones are left out with a warning", "tests"),
    "tendon_joint*": ("act", "tests"),
    "tendon_coef": ("acts", "tests"),
    "tendon_stiffness": ("acts", "tests"),
    "tendon_springlength": ("acts", "tests"),
    "tendon_damping": ("acts", "tests"),
    "tendon_limited": ("left out with a warning", ""),
    "tendon_range": ("left out with a warning", ""),
    "tendon_frictionloss": ("left out with a warning", ""),
    "tendon_armature": ("left out with a warning", ""),
    "tendon_label": ("names things", ""),
    "tendon_world": ("names things", ""),
    "tendon_articulation": ("names things", ""),
    "tendon_wrap_*": ("ignored: of spatial tendons, which are left out with a warning", ""),
    "tendon_*": ("ignored: of limits and friction of tendons, left out with a warning", ""),
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

# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""What a solver says about a model that it cannot simulate, before it simulates anything."""

import operator
import warnings
from collections.abc import Sequence
from typing import Any

import newton
import numpy as np
import warp as wp

from .attributes import authored_fluid, break_limits, dahl_friction
from .effects import CAUSES
from .flags import flags_off, still_on
from .model.actuators import Actuators, authored
from .model.condim import CONDIMS, Condims
from .model.equalities import equalities, lonely_rows, unheard_rows
from .model.rotations import transform
from .model.tendons import left_joints, tendon_count, tendon_equalities, tendon_name, tendons
from .rows import actuator as rules
from .rows.joint import KINDS

_OPEN = 0.01
"""Distance [m] by which a joint is open that nobody means to be."""
_MOST_NAMES = 3
"""Labels in a message."""
_INVERSE = 0.02
"""How far a mass times its inverse may be from 1: far above rounding, below what anybody means."""
_UNIT = 1.0e-3
"""How far the length of an axis or a quaternion may be from 1."""
_SKEW = 1.0e-3
"""How far an inertia tensor may be from symmetric and from the triangle inequality, by its largest
moment; rounding of a thin plate's is far below."""
_OF_MUJOCO = (
    "gravcomp",
    "ctrl",
    *(f"actuator_{name}" for name in ("gear", "gainprm", "biasprm", "dynprm")),
    *(f"actuator_{name}" for name in ("lengthrange", "cranklength", "dampingpoly")),
)
"""Attributes of the ``mujoco`` namespace that act, finite."""
_NOT_NEGATIVE = ("actuator_armature", "actuator_damping")
"""The same, and none below zero."""
_OF_AXES = ("dof_ref", "limit_margin")
"""The same by degree of freedom, finite."""
_OF_TENDONS = ("stiffness", "damping", "frictionloss", "armature")
"""The same of tendons, none below zero."""
_COEFFICIENTS = (
    "joint_target_ke",
    "joint_target_kd",
    "joint_limit_ke",
    "joint_limit_kd",
    "joint_damping",
    "joint_stiffness",
    "joint_armature",
    "joint_friction",
)
"""Of a degree of freedom, at least zero."""
_OF_GUIDES = {
    "tendon_guide_radius": "radius",
    "tendon_guide_mu": "mu",
    "tendon_segment_compliance": "compliance",
    "tendon_segment_damping": "damping",
}
"""Arrays of numbers that are finite and not negative, and the fields of a ``TendonGuide``."""


def check_model(model: newton.Model, *, ramp: bool = False) -> None:
    """Refuses a model that holds what the solver does not support or cannot make sense of.

    Args:
        model: The model, on any device; its arrays are copied to the host.
        ramp: Whether it is to be solved by the ramped formulation.

    Raises:
        NotImplementedError: If a joint is of a type that the solver does not know.
        ValueError: If a pose, velocity, mass, inertia, center of mass, joint frame, axis, limit,
            gain, material coefficient, gravity or wind is not finite, a mass, gain or coefficient
            is negative, an inertia not symmetric or not positive, an axis or the quaternion of a
            frame not of unit length, a condim is none of MuJoCo's, or the path of a tendon makes
            no sense.
    """
    _check_joints(model, ramp)
    _check_bodies(model)
    _check_cables(model)
    if model.shape_count:
        for name in ("mu", "mu_torsional", "mu_rolling", "restitution", "ke", "kd"):
            _check_numbers(model, f"shape_material_{name}", model.shape_label, minimum=0.0)
        _check_numbers(model, "shape_transform", model.shape_label)
        _check_lengths(model, "shape_transform", model.shape_label)
        _check_condims(model)
    for name in (*_OF_MUJOCO, *_NOT_NEGATIVE):
        if authored(model, name) is not None:
            labels = getattr(model.mujoco, "actuator_label", ())
            labels = model.body_label if name == "gravcomp" else labels
            least = 0.0 if name in _NOT_NEGATIVE else -np.inf
            _check_numbers(model, f"mujoco.{name}", labels, minimum=least)
    _check_ranges(model)
    _check_time_constants(model)
    for name in _OF_TENDONS if tendon_count(model) else ():
        _check_numbers(model, f"mujoco.tendon_{name}", model.mujoco.tendon_label, minimum=0.0)
    for name in ("springlength", "range", "margin") if tendon_count(model) else ():
        _check_numbers(model, f"mujoco.tendon_{name}", model.mujoco.tendon_label)
    if authored(model, "tendon_coef") is not None:
        _check_numbers(model, "mujoco.tendon_coef", ())
    tendons(model)
    if not np.all(np.isfinite(model.gravity.numpy())):
        raise ValueError("model.gravity is not finite; set it with model.set_gravity().")
    _check_fluid(model)


def report_ignored(
    model: newton.Model,
    *,
    strict: bool = False,
    rigid_contacts: bool = True,
    angular_friction: bool | None = False,
    own_rows: np.ndarray | None = None,
    without: frozenset[str] = frozenset(),
) -> None:
    """Says what a model holds that the solver leaves alone, with the remedy.

    Particles that are not active, or are a coupled solver's proxies, are another solver's and not
    mentioned, nor what is made of them.

    Args:
        model: The model; arrays of what is mentioned are copied to the host.
        strict: Raise instead of warn.
        rigid_contacts: Whether contacts are rigid, so that restitution acts.
        angular_friction: Whether torsional and rolling friction act; None if nobody said.
        own_rows: Rows of MuJoCo's equality constraints that the solver makes joints of; None for
            those of a new one.
        without: Effects that the user leaves out.

    Raises:
        NotImplementedError: If ``strict`` and there is such a thing.
    """
    messages = []
    if own_rows is None:
        own_rows = lonely_rows(model)
    if others := _deformables(model):
        messages.append(
            f"SolverAVBD moves rigid bodies only; it leaves out the model's {', '.join(others)}. "
            "Use SolverVBD for them, alone or coupled with this solver."
        )
    if rows := _equalities(model, own_rows):
        messages.append(
            f"SolverAVBD leaves out {', '.join(rows)}: JOINT constraints tie axes of two joints, "
            "or hold one, of other types than BALL and FREE; CONNECT and WELD constraints tie two "
            "bodies, or one to the world (-1)."
        )
    if rows := _named_rows(model, unheard_rows(model, own_rows)):
        messages.append(
            f"SolverAVBD leaves out {', '.join(rows)}: enabled, but the joint that the importer "
            "made of it has been disabled since. Enable that, too (model.joint_enabled), or "
            "disable the row (model.mujoco.equality_constraint_enabled)."
        )
    if idle := _idle_tendons(model):
        messages.append(
            f"SolverAVBD leaves out {', '.join(idle)}, which combine no joint of one axis: "
            "Newton's importer does not say which axis of a joint of several is meant. Give the "
            "joints bodies of their own in the file."
        )
    if parts := _parts_of_tendons(model):
        messages.append(
            f"SolverAVBD leaves out {', '.join(parts)}: Newton's importer does not say which axis "
            "of a joint of several is meant. Give each of its joints a body of its own in the file."
        )
    if actuators := _actuators(model):
        messages.append(
            f"SolverAVBD leaves out {', '.join(actuators)}. Push with control.joint_f or "
            "state.body_f instead, or use SolverMuJoCo."
        )
    if adhesive := _shapes(model, _material(model, "ka") > 0.0):
        messages.append(
            f"SolverAVBD leaves out the adhesion (ka) of {', '.join(adhesive)}. Only the penalty "
            "contacts of SolverSemiImplicit use it."
        )
    if not rigid_contacts and (bouncing := _shapes(model, _material(model, "restitution") > 0.0)):
        messages.append(
            f"SolverAVBD leaves out the restitution of {', '.join(bouncing)}: it acts on rigid "
            "contacts only. Compliant and ramped ones rebound by their ke and kd."
        )
    if "contact" not in without:
        messages += _of_pairs(model)
    off = {flag: found for flag in flags_off(model) if (found := still_on(model, flag, without))}
    if off:
        found = list(dict.fromkeys(name for names in off.values() for name in names))
        messages.append(
            f"SolverAVBD ignores MuJoCo's flags, of which {', '.join(off)} would be off. "
            f"{_instead_of_flags(found)}"
        )
    if angular_friction is None and (turning := _shapes(model, _has_own_angular_friction(model))):
        messages.append(
            f"SolverAVBD leaves out the torsional and rolling friction of {', '.join(turning)}. "
            "Pass angular_friction=True for it, or False to say that it is to be left out."
        )
    if crossed := _crossed_limits(model):
        messages.append(
            f"The lower limit of {', '.join(crossed)} is above the upper one, so no coordinate is "
            "within. Swap them, or set them to -newton.MAXVAL and newton.MAXVAL for no limit."
        )
    if strict and messages:
        raise NotImplementedError("\n".join(messages))
    for message in messages:
        warnings.warn(message, stacklevel=3)


def report_open_joints(model: newton.Model, body_q: np.ndarray) -> None:
    """Warns of joints that turn only, and that the first poses leave open.

    So they are where a program sets coordinates of joints and leaves the poses to the solver, as
    ``SolverMuJoCo`` has it.

    Args:
        model: The model.
        body_q: Poses of its bodies, shape (body_count, 7) [m, quaternion].
    """
    if model.joint_count == 0:
        return
    turning = [newton.JointType[name] for name in ("REVOLUTE", "BALL", "FIXED", "D6")]
    watched = np.isin(model.joint_type.numpy(), [int(kind) for kind in turning])
    watched &= (model.joint_dof_dim.numpy()[:, 0] == 0) & (model.joint_articulation.numpy() >= 0)
    joints = np.flatnonzero(watched & model.joint_enabled.numpy())
    poses = np.vstack([body_q, (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)])  # the last is the world's
    parent, child = (
        transform(poses[side.numpy()[joints]], frame.numpy()[joints, :3])
        for side, frame in (
            (model.joint_parent, model.joint_X_p),
            (model.joint_child, model.joint_X_c),
        )
    )
    apart = np.linalg.norm(child - parent, axis=1)
    is_open = apart > _OPEN
    if is_open.any():
        labels = [_label(model.joint_label, joint) for joint in joints[is_open]]
        names = _named(len(labels), "joint", labels)[0]
        warnings.warn(
            f"SolverAVBD starts from body_q, which leaves {names} open, by up to {apart.max():.3g} "
            "m. If joint_q is what you mean, call newton.eval_fk(model, state.joint_q, "
            "state.joint_qd, state) before the first step, or pass update_joint_state=True.",
            stacklevel=3,
        )


def _named(count: int, what: str, labels: Sequence[str] = ()) -> list[str]:
    """ "12 springs", with the first labels where there are any; empty without a thing."""
    if count == 0:
        return []
    names = ", ".join(repr(label) for label in labels[:_MOST_NAMES])
    names += ", ..." if names and count > _MOST_NAMES else ""
    return [f"{count} {what}{'s' if count > 1 else ''}" + (f" ({names})" if names else "")]


def _deformables(model: newton.Model) -> list[str]:
    """Particles that this solver is to move, what is made of them, and muscles."""
    found = []
    if model.particle_count:
        flags = model.particle_flags.numpy()
        ours = (flags & int(newton.ParticleFlags.ACTIVE) != 0) & (
            flags & int(newton.ParticleFlags.PROXY) == 0
        )
        found += _named(int(ours.sum()), "particle")
        ours = np.append(ours, False)  # -1: no particle

        def made_of_ours(count: int, indices: wp.array) -> int:
            return int(ours[indices.numpy().reshape(count, -1)].any(axis=1).sum()) if count else 0

        found += _named(made_of_ours(model.spring_count, model.spring_indices), "spring")
        found += _named(made_of_ours(model.tri_count, model.tri_indices), "triangle")
        found += _named(made_of_ours(model.edge_count, model.edge_indices), "bending edge")
        found += _named(made_of_ours(model.tet_count, model.tet_indices), "tet")
        for kind, count in (("surface", model.surface_count), ("volume", model.volume_count)):
            if count:
                starts = getattr(model, f"{kind}_particle_start").numpy()
                ends = getattr(model, f"{kind}_particle_end").numpy()
                labels = getattr(model, f"{kind}_label")
                labels = [labels[i] for i in range(count) if ours[starts[i] : ends[i]].any()]
                found += _named(len(labels), kind, labels)
        if model.attachment_particle_body_count:
            held = ours[model.attachment_particle_body_particle.numpy()]
            held &= model.attachment_particle_body_enabled.numpy()
            bodies = model.attachment_particle_body_body.numpy()[held]
            labels = [f"body {_label(model.body_label, body)}" for body in bodies]
            found += _named(len(labels), "particle attachment", labels)
    if model.muscle_count:
        first = model.muscle_bodies.numpy()[model.muscle_start.numpy()[: model.muscle_count]]
        labels = [f"from body {_label(model.body_label, body)}" for body in first]
        found += _named(model.muscle_count, "muscle", labels)
    return found


def _equalities(model: newton.Model, own_rows: np.ndarray) -> list[str]:
    """MuJoCo's equality constraints that no importer made a joint of, and that nothing obeys."""
    mujoco: Any = getattr(model, "mujoco", None)
    counts = model.custom_frequency_counts
    found = []
    if counts.get("mujoco:equality_constraint", 0):
        left = mujoco.equality_constraint_enabled.numpy() & (
            mujoco.equality_constraint_target.numpy() < 0
        )
        left[[equality.row for equality in equalities(model)]] = False
        left[[equality.row for equality in tendon_equalities(model, tendons(model))]] = False
        left[own_rows] = False
        found += _named_rows(model, np.flatnonzero(left))
    return found


def _named_rows(model: newton.Model, rows: np.ndarray) -> list[str]:
    """MuJoCo's equality constraints by their labels, those without one by their rows."""
    labels = model.mujoco.equality_constraint_label if rows.size else ()
    names = [_label(labels, row) or f"row {row}" for row in rows.tolist()]
    return _named(len(names), "MuJoCo equality constraint", names)


def _idle_tendons(model: newton.Model) -> list[str]:
    """MuJoCo's tendons of which nothing acts."""
    acting = {tendon.row for tendon in tendons(model)}
    labels = [
        model.mujoco.tendon_label[row] for row in range(tendon_count(model)) if row not in acting
    ]
    return _named(len(labels), "MuJoCo tendon", labels)


def _parts_of_tendons(model: newton.Model) -> list[str]:
    """Joints that MuJoCo's fixed tendons go without, though others of theirs act."""
    found = left_joints(model)
    return [
        f"joint {_label(model.joint_label, joint)!r} of {tendon_name(model, row)}"
        for row, joint in found[:_MOST_NAMES]
    ] + (["..."] if len(found) > _MOST_NAMES else [])


def _actuators(model: newton.Model) -> list[str]:
    """MuJoCo's own actuators that the solver does not know, each with the reason."""
    found = Actuators.of_model(model)
    return [
        f"MuJoCo actuator {row} ('{found.labels[row]}'): {why}"
        for row, why in list(found.left.items())[:_MOST_NAMES]
    ] + (["..."] if len(found.left) > _MOST_NAMES else [])


def _check_ranges(model: newton.Model) -> None:
    """Refuses ranges of actuators that are not numbers, or hold and end before they begin."""
    mujoco: Any = getattr(model, "mujoco", None)
    for name in ("ctrl", "force", "act") if hasattr(mujoco, "actuator_ctrlrange") else ():
        ends = getattr(mujoco, f"actuator_{name}range").numpy()
        holds = getattr(mujoco, f"actuator_{name}limited").numpy() == 1
        wrong = np.isnan(ends).any(axis=1) | (holds & (ends[:, 0] > ends[:, 1]))
        says = "must be two numbers, the smaller one first"
        _refuse(wrong, f"mujoco.actuator_{name}range", mujoco.actuator_label, says, ends)


def _check_time_constants(model: newton.Model) -> None:
    """Refuses dynamics that leave their control: by less than no time, or a filter at once.

    MuJoCo takes the least number above zero instead. A filter without time then overshoots 1e12
    times; an exact one takes on its control.
    """
    mujoco: Any = getattr(model, "mujoco", None)
    if not hasattr(mujoco, "actuator_dyntype"):
        return
    times = mujoco.actuator_dynprm.numpy()
    kinds = mujoco.actuator_dyntype.numpy()
    for kind, count in ((rules.FILTER, 1), (rules.EXACT_FILTER, 1), (rules.MUSCLE_DYNAMICS, 3)):
        wrong = np.any(times[:, :count] < 0.0, axis=1)
        if kind == rules.FILTER:
            wrong |= times[:, 0] == 0.0
        rows = np.flatnonzero(wrong & (kinds == int(kind)))
        if rows.size:
            row = int(rows[0])
            least = "above zero" if kind == rules.FILTER else "no less than zero"
            instead = ", or use dyntype='none' to follow the control at once" if count == 1 else ""
            raise ValueError(
                f"model.mujoco.actuator_dynprm[{row}] ('{_label(mujoco.actuator_label, row)}') "
                f"must begin with time constants that are {least}: "
                f"{times[row, :count].tolist()} s. Set them{instead}."
            )


def _check_condims(model: newton.Model) -> None:
    """Refuses a condim that MuJoCo does not have."""
    condims = Condims.of_model(model)
    names = " or ".join(map(str, CONDIMS))
    for values, what, labels in (
        (condims.condim, "mujoco.condim", model.shape_label),
        (condims.pair_condim, "mujoco.pair_condim", condims.labels(model)),
    ):
        _refuse(~np.isin(values, CONDIMS), what, labels, f"must be {names}", values)
    numbers = np.column_stack((condims.pair_friction, condims.pair_margin))
    is_sound = np.isfinite(numbers).all(axis=1) & (condims.pair_friction >= 0.0).all(axis=1)
    if not is_sound.all():
        item = int(np.argmin(is_sound))
        raise ValueError(
            f"The explicit pair {condims.labels(model)[item]} must have finite numbers, and no "
            f"negative friction: friction {condims.pair_friction[item].tolist()}, margin "
            f"{condims.pair_margin[item]} (model.mujoco.pair_*)."
        )


def _instead_of_flags(found: list[str]) -> str:
    """A sentence on what turns off some effects and arrays of the model."""
    effects = [name for name in found if name in CAUSES]
    zeroed = [name for name in found if name not in CAUSES]
    ways = []
    if effects:
        ways.append(f"pass effects={{{', '.join(f'{name!r}: False' for name in effects)}}}")
    if zeroed:
        calls = ", ".join(f"model.{name}.zero_()" for name in zeroed)
        ways.append(f"call {calls} before the solver is made")
    return f"To have the same here, {' and '.join(ways)}."


def _of_pairs(model: newton.Model) -> list[str]:
    """What of MuJoCo's explicit pairs does not act, with the remedy."""
    condims = Condims.of_model(model)
    if not len(condims.pairs):
        return []
    messages, labels = [], condims.labels(model)
    delivered = {tuple(sorted(pair)) for pair in model.shape_contact_pairs.numpy().tolist()}
    missing = [i for i, pair in enumerate(condims.pairs.tolist()) if tuple(pair) not in delivered]
    if missing:
        names = _named(len(missing), "explicit pair", [labels[i] for i in missing])
        messages.append(
            f"Newton's collision pipeline makes no contacts for {names[0]}, whose shapes do not "
            "collide otherwise. Add the pairs to model.shape_contact_pairs, and make a "
            "CollisionPipeline with broad_phase='explicit'."
        )
    if (uneven := condims.uneven_pairs()).size:
        names = _named(uneven.size, "explicit pair", [labels[i] for i in uneven])
        messages.append(
            f"SolverAVBD has the same friction in all directions; of {names[0]} it takes the mean."
        )
    return messages


def _crossed_limits(model: newton.Model) -> list[str]:
    """Joints with an axis whose lower limit is above its upper one; empty where there are none.

    Some files mean no limit by that, as PyBullet does. DISTANCE joints write a negative distance
    where they have none.
    """
    if model.joint_count == 0:
        return []
    crossed = model.joint_limit_lower.numpy() > model.joint_limit_upper.numpy()
    owner = np.repeat(np.arange(model.joint_count), model.joint_dof_dim.numpy().sum(axis=1))
    joints = np.unique(owner[crossed])
    joints = joints[model.joint_type.numpy()[joints] != int(newton.JointType.DISTANCE)]
    labels = [_label(model.joint_label, joint) for joint in joints]
    return _named(len(labels), "joint", labels)


def _shapes(model: newton.Model, concerned: np.ndarray) -> list[str]:
    """The shapes that a mask selects; empty where there are none."""
    labels = [_label(model.shape_label, i) for i in np.flatnonzero(concerned)]
    return _named(len(labels), "shape", labels)


def _material(model: newton.Model, name: str) -> np.ndarray:
    """A material coefficient of all shapes."""
    return getattr(model, f"shape_material_{name}").numpy() if model.shape_count else np.zeros(0)


def _has_own_angular_friction(model: newton.Model) -> np.ndarray:
    """Which shapes have torsional and rolling friction other than what Newton gives to all."""
    default = newton.ModelBuilder.ShapeConfig()
    twist, roll = _material(model, "mu_torsional"), _material(model, "mu_rolling")
    is_own = (twist != np.float32(default.mu_torsional)) | (roll != np.float32(default.mu_rolling))
    condims = Condims.of_model(model)
    if condims.condim.size:
        is_own &= ~condims.is_own  # their condim says whether it acts
    return is_own & ((twist > 0.0) | (roll > 0.0))


def _check_joints(model: newton.Model, ramp: bool) -> None:
    if model.joint_count == 0:
        return
    free = int(newton.JointType.FREE)
    for joint, kind in enumerate(model.joint_type.numpy().tolist()):
        if kind not in KINDS or (ramp and kind != free):
            where = " with formulation='ramp'" if ramp else ""
            raise NotImplementedError(
                f"SolverAVBD does not support joint {joint} '{_label(model.joint_label, joint)}' "
                f"of type {newton.JointType(kind).name}{where}."
            )
    for name in ("joint_X_p", "joint_X_c"):
        _check_numbers(model, name, model.joint_label)
        _check_lengths(model, name, model.joint_label)
    for name in ("joint_q", "joint_rest_q"):
        _check_numbers(model, name, ())
    _check_numbers(model, "joint_mimic_coeffs", model.joint_label)
    if model.custom_frequency_counts.get("mujoco:equality_constraint", 0):
        labels = model.mujoco.equality_constraint_label
        for name in ("polycoef", "anchor", "relpose"):
            _check_numbers(model, f"mujoco.equality_constraint_{name}", labels)
    owner = np.repeat(np.arange(model.joint_count), model.joint_dof_dim.numpy().sum(axis=1))
    labels = [_label(model.joint_label, joint) for joint in owner]
    for name in ("joint_axis", "joint_limit_lower", "joint_limit_upper"):
        _check_numbers(model, name, labels)
    for name in _OF_AXES:
        if authored(model, name) is not None:
            _check_numbers(model, f"mujoco.{name}", labels)
    _check_lengths(model, "joint_axis", labels)
    for name in _COEFFICIENTS:
        _check_numbers(model, name, labels, minimum=0.0)
    for name in ("joint_effort_limit", "joint_velocity_limit"):
        _check_most(name, getattr(model, name), labels)
    for name, values in dahl_friction(model).items():
        _check_most(f"vbd.{name}", values, model.joint_label)
    for name, limit in break_limits(model).items():
        _check_most(f"avbd.{name}", limit, model.joint_label)


def _check_most(name: str, most: wp.array, labels: list[str]) -> None:
    """Raises a ValueError that names the first of some bounds, which may be infinite, that makes
    no sense."""
    values = most.numpy()
    _refuse(~(values >= 0.0), name, labels, "must be 0 or more, or infinite", values)


def _check_bodies(model: newton.Model) -> None:
    if model.body_count == 0:
        return
    _check_numbers(model, "body_mass", model.body_label, minimum=0.0)
    for name in ("inertia", "inv_mass", "inv_inertia", "com", "q", "qd"):
        _check_numbers(model, f"body_{name}", model.body_label)
    _check_inertia(model)
    mass = model.body_mass.numpy()
    moments = np.diagonal(model.body_inertia.numpy(), axis1=1, axis2=2)
    locked = np.flatnonzero((mass > 0.0) & np.all(moments <= 0.0, axis=1))
    if locked.size:
        raise ValueError(
            f"body {locked[0]} '{_label(model.body_label, locked[0])}' has a mass but no inertia; "
            "give it a shape with density, or set body_inertia and body_inv_inertia."
        )
    inv_mass = model.body_inv_mass.numpy()
    product = np.matmul(model.body_inertia.numpy(), model.body_inv_inertia.numpy())
    has_inverse = np.any(model.body_inv_inertia.numpy() != 0.0, axis=(1, 2))
    for name, differs in (
        ("mass", (inv_mass > 0.0) & (np.abs(mass * inv_mass - 1.0) > _INVERSE)),
        ("inertia", has_inverse & (np.abs(product - np.eye(3)).max(axis=(1, 2)) > _INVERSE)),
    ):
        if np.any(differs):
            body = int(np.flatnonzero(differs)[0])
            raise ValueError(
                f"model.body_inv_{name}[{body}] ('{_label(model.body_label, body)}') is not the "
                f"inverse of body_{name}[{body}]; change both."
            )


def _check_fluid(model: newton.Model) -> None:
    if (authored := authored_fluid(model)) is None:
        return
    for name, least in (("density", 0.0), ("viscosity", 0.0), ("wind", -np.inf)):
        values = getattr(authored, name).numpy()
        if not np.all(np.isfinite(values) & (values >= least)):
            need = "finite" if least < 0.0 else "finite, and 0 or more"
            raise ValueError(f"model.mujoco.{name} must be {need}: {values.tolist()}.")


def _check_inertia(model: newton.Model) -> None:
    """Refuses what is no inertia tensor, and warns of one that no mass can have."""
    heavy = np.flatnonzero(model.body_mass.numpy() > 0.0)
    inertia = model.body_inertia.numpy()[heavy].astype(np.float64)
    across = inertia.transpose(0, 2, 1)
    moments = np.linalg.eigvalsh(0.5 * (inertia + across))
    allowed = _SKEW * np.abs(moments).max(axis=1)
    skew = np.abs(inertia - across).max(axis=(1, 2)) > allowed
    uneven = moments[:, 2] - moments[:, 0] - moments[:, 1] > allowed
    for wrong, problem in (
        (skew, "is not symmetric"),
        (moments[:, 0] < 0.0, "has a negative principal moment"),
    ):
        if np.any(wrong):
            i = int(np.flatnonzero(wrong)[0])
            raise ValueError(
                f"model.body_inertia[{heavy[i]}] ('{_label(model.body_label, heavy[i])}') "
                f"{problem}: {inertia[i].tolist()}."
            )
    if np.any(uneven):
        labels = [_label(model.body_label, body) for body in heavy[uneven]]
        warnings.warn(
            f"No mass has such moments of inertia as body {labels[0]!r} (one of {len(labels)}): "
            "the largest is above the sum of the others. It is simulated as it is; finalize() "
            "without skip_validation_inertia corrects it.",
            stacklevel=5,
        )


def _check_lengths(model: newton.Model, name: str, labels: Sequence[str]) -> None:
    """Raises a ValueError that names the first axis or quaternion that is not of unit length."""
    values = getattr(model, name).numpy()
    if values.size == 0:
        return
    # the last four numbers of a frame, the three of an axis
    lengths = np.linalg.norm(values[:, -4:] if values.shape[1] == 7 else values, axis=1)
    what = "a unit quaternion" if values.shape[1] == 7 else "a unit vector"
    _refuse(np.abs(lengths - 1.0) > _UNIT, name, labels, f"is not {what}", values)


def check_array(name: str, array: wp.array | None, count: int, device: wp.Device) -> None:
    """Raises a ValueError where an argument's array is missing, too short, or elsewhere.

    Args:
        name: What to call it.
        array: The array.
        count: Entries that it must have.
        device: Device that it must be on.
    """
    if array is None or array.shape[0] < count:
        size = "is None" if array is None else f"has {array.shape[0]} entries"
        raise ValueError(f"{name} {size}, {count} are needed; it belongs to another model.")
    if array.device != device:
        raise ValueError(f"{name} is on device {array.device}, the solver on {device}.")


def _check_numbers(
    model: newton.Model, name: str, labels: Sequence[str], minimum: float = -np.inf
) -> None:
    """Raises a ValueError that names the first entry of a model array that makes no sense."""
    values = operator.attrgetter(name)(model).numpy()
    if values.size == 0:
        return
    per_item = values.reshape(len(values), -1)
    wrong = ~np.all(np.isfinite(per_item) & (per_item >= minimum), axis=1)
    is_finite = np.all(np.isfinite(per_item[wrong.argmax()]))
    _refuse(wrong, name, labels, "is negative" if is_finite else "is not finite", values)


def _refuse(
    wrong: np.ndarray, name: str, labels: Sequence[str], says: str, values: np.ndarray
) -> None:
    """Raises a ValueError that names the first entry of a model array that is wrong, if one is."""
    if wrong.any():
        item = int(wrong.argmax())
        raise ValueError(f"model.{name}[{item}] ('{_label(labels, item)}') {says}: {values[item]}.")


def _label(labels: Sequence[str], index: int | np.integer) -> str:
    return labels[int(index)] if index < len(labels) else ""


def _check_cables(model: newton.Model) -> None:
    """Refuses cables that make no sense; copies their arrays to the host.

    Raises:
        ValueError: If a cable has fewer than two guides, a guide is on a body that there is not, a
            number is not finite, or a radius, friction coefficient, compliance or damping is
            negative, a roller has no radius, a side is not 1 or -1, or an axis is not of unit
            length.
    """
    count = model.tendon_count
    if count == 0:
        return
    start = model.tendon_start.numpy()

    def name(cable: int) -> str:
        return f"tendon {cable} ('{model.tendon_label[cable]}')"

    def of_guide(guide: int) -> str:
        cable = int(np.searchsorted(start, guide, side="right")) - 1
        return f"guide {guide - start[cable]} of {name(cable)}"

    def of_segment(segment: int) -> str:
        first = start[:-1] - np.arange(count)
        cable = int(np.searchsorted(first, segment, side="right")) - 1
        return f"guide {segment - first[cable] + 1} of {name(cable)}"

    short = np.flatnonzero(np.diff(start) < 2)
    if short.size:
        raise ValueError(
            f"{name(short[0])} has fewer than two guides. Give add_tendon() both of its ends."
        )
    body = model.tendon_guide_body.numpy()
    missing = np.flatnonzero((body < -1) | (body >= model.body_count))
    if missing.size:
        raise ValueError(
            f"{of_guide(missing[0])} is on body {body[missing[0]]}, and the model has "
            f"{model.body_count}. Pass TendonGuide(body=) an index of add_body() or add_link(), or "
            "-1 for the world."
        )
    for array, field in _OF_GUIDES.items():
        values = getattr(model, array).numpy()
        wrong = np.flatnonzero(~(np.isfinite(values) & (values >= 0.0)))
        if wrong.size:
            where = of_segment if "segment" in array else of_guide
            raise ValueError(
                f"model.{array} of {where(wrong[0])} is {values[wrong[0]]}: set {field} to a "
                "finite number of at least 0."
            )
    rest = model.tendon_segment_rest_length.numpy()
    for array, where, values in (
        ("tendon_segment_rest_length", of_segment, rest[:, None]),
        ("tendon_guide_offset", of_guide, model.tendon_guide_offset.numpy()),
        ("tendon_guide_axis", of_guide, model.tendon_guide_axis.numpy()),
    ):
        wrong = np.flatnonzero(~np.isfinite(values).all(axis=1))
        if wrong.size:
            raise ValueError(f"model.{array} of {where(wrong[0])} is not finite: set it anew.")
    kind = model.tendon_guide_type.numpy()
    is_roller = kind == int(newton.TendonGuideType.ROLLER)
    thin = np.flatnonzero(is_roller & (model.tendon_guide_radius.numpy() == 0.0))
    if thin.size:
        raise ValueError(f"{of_guide(thin[0])} is a roller without a radius: set radius.")
    side = model.tendon_guide_orientation.numpy()
    wrong = np.flatnonzero(np.abs(side) != 1)
    if wrong.size:
        raise ValueError(f"{of_guide(wrong[0])} winds on side {side[wrong[0]]}: set 1 or -1.")
    length = np.linalg.norm(model.tendon_guide_axis.numpy(), axis=1)
    wrong = np.flatnonzero(is_roller & (np.abs(length - 1.0) > 1.0e-3))
    if wrong.size:
        raise ValueError(
            f"The axis of {of_guide(wrong[0])} has the length {length[wrong[0]]}: normalize it."
        )

# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Which effects a scene calls for. Kernels hold code for those and no others."""

import dataclasses
import operator
from dataclasses import dataclass, field

import newton
import numpy as np

from .attributes import break_limits
from .rows.joint import NO_LIMIT, PUSHED_AT_COM, JointKinds
from .topology import Topology

_FREE = int(newton.JointType.FREE)

_LIGHT = 1.0e-5
"""Share of what it carries, in mass or inertia, below which a root counts as light. (At 5e-7 what
the joints of a heavy body round moves it more than its own momentum does; at 5e-6 not yet.)"""


@dataclass(frozen=True)
class Effects:
    """The effects that a solver's kernels are compiled with."""

    contact: bool
    """Shapes that can touch."""
    friction: bool
    """A shape with a friction coefficient above zero."""
    gyroscopic: bool
    """A body whose principal moments of inertia differ."""
    joint_force: bool
    """A joint whose generalized force is a wrench on its body: FREE, DISTANCE or ROD."""
    kinds: JointKinds = field(default_factory=JointKinds)
    """The kinds of joints that hold something."""
    reaction: bool = False
    """Such a joint below a body that moves, on which its force reacts."""
    flipped: bool = False
    """A tree that goes from the child of a joint to its parent: the child is kinematic, or held."""
    light_roots: bool = False
    """A free body whose joints carry so much more than itself that rounding would move it."""
    loops: bool = False
    """Joints outside of trees: they close a loop, or each body is a block of its own."""
    closures: bool = False
    """Joints that close loops within a tree and are solved with it, or mimics."""
    mimics: bool = False
    """A joint that mimics another."""
    drives: bool = False
    """A joint axis with a drive that has a gain."""
    limits: bool = False
    """A joint axis with a limit."""
    springs: bool = False
    """A joint axis with a passive spring or damper."""
    armature: bool = False
    """A joint axis with armature."""
    joint_friction: bool = False
    """A joint axis with friction."""
    effort_limits: bool = False
    """A joint axis with a drive whose effort is limited."""
    velocity_limits: bool = False
    """A joint axis with a velocity limit."""
    breaking: bool = False
    """A joint that breaks at some force or torque."""
    compliance: bool = False
    """Contacts and joint limits give way as the stiffness and damping that are authored say."""
    piles: bool = False
    """Free bodies in contact are solved at once."""
    bdf2: bool = False
    """Asked for: second order in time."""
    ramp: bool = False
    """The seed document's formulation: penalties that grow, and no multipliers."""
    friction_mix: str = "geometric_average"
    """How the friction coefficients of two shapes mix."""
    angular_friction: bool = False
    """Asked for, and a shape with torsional or rolling friction."""
    restitution: bool = False
    """A shape with a restitution above zero."""
    matching: bool = False
    """The contact buffer in use says which contact is which."""
    moving_surfaces: bool = False
    """The contact buffer in use has surface velocities."""
    contact_materials: bool = False
    """The contact buffer in use has materials of its own for each contact."""

    @classmethod
    def of_model(
        cls,
        model: newton.Model,
        topology: Topology,
        *,
        piles: bool,
        compliance: bool,
        ramp: bool,
        friction_mix: str,
        angular_friction: bool,
        bdf2: bool,
    ) -> "Effects":
        """Reads from the model which effects it calls for; copies model arrays to the host."""
        contact = model.body_count > 0 and model.shape_count > 0
        types = model.joint_type.numpy() if model.joint_count else np.zeros(0)
        axes = _axes(model)
        drives = _is_driven(model, axes)
        mu = model.shape_material_mu.numpy() if contact else np.zeros(0)
        return cls(
            contact=contact,
            piles=piles and contact and not ramp,
            friction=bool(np.any(mu > 0.0)),
            gyroscopic=_has_unequal_moments(model),
            joint_force=bool(np.any(np.isin(types, [int(kind) for kind in PUSHED_AT_COM]))),
            kinds=JointKinds.of_model(model),
            loops=topology.loops.size > 0,
            closures=bool(topology.closures),
            mimics=any(closure.leader >= 0 for closure in topology.closures),
            flipped=topology.has_flips,
            light_roots=_has_light_root(model, topology),
            reaction=pushing_joints(model).size > 0,
            drives=bool(np.any(drives)),
            limits=_has_limits(model, axes),
            springs=_has_any(model, ("joint_damping", "joint_stiffness"), axes),
            armature=_has_any(model, ("joint_armature",), axes),
            joint_friction=_has_any(model, ("joint_friction",), axes),
            effort_limits=_is_limited(model, "joint_effort_limit", axes[drives], -1.0),
            velocity_limits=_is_limited(model, "joint_velocity_limit", axes, 0.0),
            breaking=bool(break_limits(model)),
            compliance=compliance,
            bdf2=bdf2,
            ramp=ramp,
            friction_mix=friction_mix,
            angular_friction=angular_friction and contact and _has_spin(model),
            restitution=contact and not (ramp or compliance) and has_restitution(model),
        )

    @property
    def joints(self) -> bool:
        """Whether a joint holds anything."""
        return bool(self.kinds.angular) or self.reaction

    @property
    def tilting(self) -> bool:
        """Whether the spin of a linked body may have to be tilted. (Closures take the matrix of
        their tree to be symmetric, which that would not leave it.)"""
        return self.gyroscopic and self.joints and not self.closures

    @property
    def rods(self) -> bool:
        """Whether there are ROD joints, elastic along all six axes."""
        return self.kinds.rods

    @property
    def coordinates(self) -> bool:
        """Whether something acts along joint axes that depends on their coordinates."""
        linear = self.drives or self.springs or self.armature or self.rods or self.limits
        return linear or self.laws or self.mimics

    @property
    def stops(self) -> bool:
        """Whether something stops coordinates: hard limits of position or velocity."""
        return (self.limits and not self.compliance) or self.velocity_limits

    @property
    def laws(self) -> bool:
        """Whether something that acts along joint axes is not linear in their coordinates."""
        return self.stops or self.joint_friction or self.effort_limits

    @property
    def drift(self) -> bool:
        """Whether something shifts what counts as no slip."""
        return self.moving_surfaces or self.restitution or (self.bdf2 and self.friction)

    def for_any_values(self) -> "Effects":
        """These effects and those that other values in the same arrays of the model could ask for.

        What follows from which shapes, joints and bodies there are, or from settings, stays.
        """
        return dataclasses.replace(
            self,
            friction=self.contact,
            gyroscopic=True,
            light_roots=self.joints,
            drives=self.joints,
            limits=self.joints,
            springs=self.joints,
            armature=self.joints,
            joint_friction=self.joints,
            effort_limits=self.joints,
            velocity_limits=self.joints,
        )

    def missing(self, wanted: "Effects") -> list[str]:
        """Names of those of other effects that these do not hold."""
        names = [field.name for field in dataclasses.fields(self)]
        new, old = (operator.attrgetter(*names)(effects) for effects in (wanted, self))
        return [name for name, a, b in zip(names, new, old, strict=True) if a and a != b]

    def without_contact(self) -> "Effects":
        """The effects of a step in which nothing touches."""
        return dataclasses.replace(
            self,
            contact=False,
            piles=False,
            friction=False,
            angular_friction=False,
            restitution=False,
            ramp=False,
        )


def pushing_joints(model: newton.Model) -> np.ndarray:
    """Joints with a parent body whose generalized force is a wrench on their child."""
    if model.joint_count == 0:
        return np.zeros(0, dtype=int)
    pushing = np.isin(model.joint_type.numpy(), [int(kind) for kind in PUSHED_AT_COM])
    return np.flatnonzero(pushing & (model.joint_parent.numpy() >= 0))


def _axes(model: newton.Model) -> np.ndarray:
    """Degrees of freedom of joints that list their axes: not those of FREE joints and the like."""
    if model.joint_count == 0:
        return np.zeros(0, dtype=int)
    types, dims = model.joint_type.numpy(), model.joint_dof_dim.numpy().sum(axis=1)
    starts = model.joint_qd_start.numpy()
    driven = ~np.isin(types, (_FREE, int(newton.JointType.ROD), int(newton.JointType.DISTANCE)))
    return np.concatenate(
        [np.arange(starts[j], starts[j] + dims[j]) for j in np.flatnonzero(driven)]
        or [np.zeros(0, dtype=int)]
    )


def _is_driven(model: newton.Model, axes: np.ndarray) -> np.ndarray:
    """Which of the joint axes have a drive that could act."""
    if axes.size == 0:
        return np.zeros(0, dtype=bool)
    mode = model.joint_target_mode.numpy()[axes]
    gain = model.joint_target_ke.numpy()[axes] + model.joint_target_kd.numpy()[axes]
    passive = (int(newton.JointTargetMode.NONE), int(newton.JointTargetMode.EFFORT))
    return (gain != 0.0) & ~np.isin(mode, passive)


def _has_limits(model: newton.Model, axes: np.ndarray) -> bool:
    """Whether one of the joint axes has a limit."""
    if axes.size == 0:
        return False
    lower, upper = model.joint_limit_lower.numpy()[axes], model.joint_limit_upper.numpy()[axes]
    return bool(np.any((lower > -newton.MAXVAL) | (upper < newton.MAXVAL)))


def _has_spin(model: newton.Model) -> bool:
    """Whether a shape has torsional or rolling friction."""
    twist, roll = model.shape_material_mu_torsional.numpy(), model.shape_material_mu_rolling.numpy()
    return bool(np.any(twist > 0.0) or np.any(roll > 0.0))


def has_restitution(model: newton.Model) -> bool:
    """Whether a shape gives back some of an impact."""
    return model.shape_count > 0 and bool(np.any(model.shape_material_restitution.numpy() > 0.0))


def _has_any(model: newton.Model, names: tuple[str, ...], axes: np.ndarray) -> bool:
    """Whether one of the joint axes has one of these coefficients above zero."""
    return axes.size > 0 and any(np.any(getattr(model, name).numpy()[axes] > 0.0) for name in names)


def _is_limited(model: newton.Model, name: str, axes: np.ndarray, least: float) -> bool:
    """Whether one of the joint axes has such a limit: below Newton's default, which says none."""
    if axes.size == 0:
        return False
    limit = getattr(model, name).numpy()[axes]
    return bool(np.any((limit > least) & (limit < NO_LIMIT)))


def _has_unequal_moments(model: newton.Model) -> bool:
    """Whether a body's inertia tensor is not a multiple of the identity, beyond rounding."""
    if model.body_count == 0:
        return False
    inertia = model.body_inertia.numpy().astype(np.float64)
    mean = np.trace(inertia, axis1=1, axis2=2) / 3.0
    off = np.abs(inertia - mean[:, None, None] * np.eye(3)).max(axis=(1, 2))
    return bool(np.any(off > 1.0e-5 * mean))


def _has_light_root(model: newton.Model, topology: Topology) -> bool:
    """Whether a body that moves, and that no joint holds, carries so much more than itself."""
    linked = np.flatnonzero(topology.parent >= 0)
    if linked.size == 0:
        return False
    mass = model.body_mass.numpy().astype(np.float64)
    moments = np.trace(model.body_inertia.numpy().astype(np.float64), axis1=1, axis2=2)
    root = np.where(topology.parent >= 0, topology.parent, np.arange(mass.size))
    while np.any(root != root[root]):
        root = root[root]
    joint = topology.joint[linked]
    is_child = model.joint_child.numpy()[joint] == linked
    frames = np.where(
        is_child[:, None], model.joint_X_c.numpy()[joint], model.joint_X_p.numpy()[joint]
    )
    arm = np.linalg.norm(frames[:, :3] - model.body_com.numpy()[linked], axis=1)
    for own, beyond in ((mass, 0.0), (moments, mass[linked] * arm**2)):
        carried = np.bincount(root[linked], own[linked] + beyond, mass.size)
        if np.any((_LIGHT * carried > own) & (model.body_inv_mass.numpy() > 0.0)):
            return True
    return False

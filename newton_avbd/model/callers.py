# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""What in a model calls for each effect: the shapes, bodies or joints, by the effect's name."""

from dataclasses import dataclass

import newton
import numpy as np

from ..attributes import authored_fluid, break_limits, dahl_friction
from ..rows.joint import NO_LIMIT, PUSHED_AT_COM
from ..settings import Settings
from .actuators import Actuators, compensated_links, compensating_axes, passed_limits
from .condim import Condims
from .limits import has_authored_limit
from .tendons import Tendon
from .topology import Topology, joint_of_dof, moving
from .welds import is_kinematic

_FREE = int(newton.JointType.FREE)
_LIGHT = 1.0e-5
"""Share of what it carries, in mass or inertia, below which a root counts as light. (At 5e-7 what
the joints of a heavy body round moves it more than its own momentum does; at 5e-6 not yet.)"""

NEEDLE = 2.0e-3
"""Least moment of a needle, as a share of the sum: of a rod 19 times as long as thick."""

LIGHT_LINK = 5.0e-3
"""Share of the mass that moves with it below which a link counts as light. So does one whose moment
of inertia is below this share of what its mass would have at the surface of its shapes."""


def find_callers(
    model: newton.Model, topology: Topology, settings: Settings, left_out: frozenset[str]
) -> dict[str, np.ndarray]:
    """Indices of what calls for each effect; copies model arrays to the host.

    Args:
        model: The model.
        topology: How its joints link its bodies.
        settings: The solver's.
        left_out: Effects that are to be left out.
    """
    user_model = getattr(model, "user_model", model)
    condims = Condims.of_model(None if "condim" in left_out else user_model)
    actuators = Actuators.of_model(user_model)
    if "actuators" in left_out:
        actuators.drives.clear()  # they go on as drives
    callers = {
        **_of_shapes(model, condims, settings.angular_friction),
        **_of_bodies(model, topology),
        **_of_links(model, topology),
        **_of_axes(model, actuators),
        **_of_pushed_bodies(model, actuators),
    }
    without = set()
    if callers["contact"].size == 0:
        without |= {"pairs", "piles", "mixing"}
    if callers["friction"].size == 0:
        without |= {"put_bodies"}
    if settings.ramp:
        without |= {"angular_friction", "restitution", "floating", "light_links"}
        without |= {"piles", "mixing"}
    if settings.compliant_contacts:
        without |= {"restitution"}
    else:
        without |= {"limit_impedance"}
    if settings.blocks == "body":
        without |= {"piles"}
    callers["fourth_order"] = callers["joints"]
    if not settings.fourth_order:
        without |= {"fourth_order"}
    # contacts are off by more than rounding, and settle by what it leaves; a cable is as taut
    # as rounding of the poses that it ties; drag and inner steps need states of their own
    others = ("contact", "cables", "servos", "fluid")
    is_carried = settings.second_order and settings.accuracy is None
    if not is_carried or any(callers[name].size for name in others):
        without |= {"carried_rounding"}
    return callers | dict.fromkeys(without, np.zeros(0, dtype=int))


def _of_shapes(
    model: newton.Model, condims: Condims, angular_friction: bool | None
) -> dict[str, np.ndarray]:
    """What calls for the effects of contacts."""
    shapes = _colliding(model)
    kinds = model.shape_type.numpy()[shapes]
    by_condim = np.union1d(np.flatnonzero(condims.is_own), condims.pairs)
    return {
        "contact": shapes,
        "cylinders": shapes[kinds == int(newton.GeoType.CYLINDER)],
        "ellipsoids": shapes[kinds == int(newton.GeoType.ELLIPSOID)],
        "friction": _frictional(model, condims),
        "angular_friction": _twisting(model, condims, angular_friction),
        "condim": np.intersect1d(shapes, by_condim),
        "contact_pairs": np.intersect1d(shapes, condims.pairs),
        "put_bodies": _put_bodies(model),
        "restitution": _shapes_with(model, "restitution"),
    }


def _of_bodies(model: newton.Model, topology: Topology) -> dict[str, np.ndarray]:
    """What calls for the effects of single bodies, and of several in a world."""
    everyone = topology.in_company(np.ones(model.body_count, dtype=bool))
    return {
        "pairs": everyone,
        "piles": topology.in_company(topology.is_alone),
        "mixing": np.setdiff1d(everyone, np.flatnonzero(topology.is_alone)),
        "gyroscopic": _unequal_moments(model),
        "needles": _needles(model, topology),
        "carried_rounding": np.arange(model.body_count),
        "light_roots": _light_roots(model, topology),
        "light_links": _light_links(model, topology),
        "fluid": bodies_in_fluid(model),
    }


def _of_links(model: newton.Model, topology: Topology) -> dict[str, np.ndarray]:
    """What calls for the effects of joints, tendons and cables, which tie bodies to each other."""
    pulled, threaded = (_tied_bodies(topology, only) for only in (False, True))
    mimics = [closure.joint for closure in topology.closures if closure.leader >= 0]
    equalities = [closure.joint for closure in topology.closures if closure.equality is not None]
    yielding = [closure.joint for closure in topology.closures if closure.yielding is not None]
    return {
        "welds": getattr(model, "weld_indices", np.zeros(0, dtype=int)),
        "joint_force": _pushing(model),
        "reaction": pushing_joints(model),
        "joints": np.union1d(linking_joints(model), _joints_of(model, pulled)),
        "flipped": topology.flipped,
        "loops": topology.loops,
        "closures": _closing_joints(model, topology, pulled),
        "mimics": np.array(mimics, dtype=int),
        "equalities": np.array(equalities, dtype=int),
        "yielding": np.array(yielding, dtype=int),
        "floating": _floating(model, topology, pulled),
        "tendons": pulled,
        "spatial_tendons": threaded,
        "cables": np.arange(model.tendon_count),
        "breaking": _breakable(model),
        "dahl": _dahl_rods(model),
    }


def _of_axes(model: newton.Model, actuators: Actuators) -> dict[str, np.ndarray]:
    """What calls for the effects of what acts along the axes of joints."""
    axes = _Axes.of_model(model)
    user_model = getattr(model, "user_model", model)
    # axes whose limits bound what they do not push by themselves
    compensated = [*compensating_axes(user_model), *passed_limits(user_model)]
    own = np.isin(axes.dofs, actuators.driven())
    driven = axes.driven() & ~own
    actuated = np.isin(axes.dofs, [*actuators.axes.values(), *compensated]) | own
    ranged = np.isin(axes.dofs, actuators.limited_axes(user_model))
    shared = actuators.is_shared(user_model)[axes.dofs] | driven
    shared = ranged & (shared | np.isin(axes.dofs, compensated))
    limited = (driven | actuated) & axes.limited("joint_effort_limit", -1.0)
    reflected = actuators.armature(user_model)[axes.dofs] > 0.0
    authored = has_authored_limit(user_model)[axes.dofs]
    return {
        "drives": axes.joints(driven),
        "actuators": axes.joints(actuated),
        "force_ranges": axes.joints(shared),
        "effort_limits": axes.joints(limited | ranged),
        "limits": axes.joints(axes.bounded()),
        "limit_impedance": axes.joints(axes.bounded() & authored),
        "velocity_limits": axes.joints(axes.limited("joint_velocity_limit", 0.0)),
        "springs": axes.joints(axes.positive("joint_damping", "joint_stiffness")),
        "armature": axes.joints(axes.positive("joint_armature") | reflected),
        "joint_friction": axes.joints(axes.positive("joint_friction")),
    }


def _of_pushed_bodies(model: newton.Model, actuators: Actuators) -> dict[str, np.ndarray]:
    """What calls for the effects of actuators that push bodies."""
    user_model = getattr(model, "user_model", model)
    pushed = [link for _, link, *_ in actuators.bodies.values()]
    return {
        "gravity_compensation": _bodies_of(model, compensated_links(user_model)),
        "body_actuators": _bodies_of(model, np.array(pushed, dtype=int)),
        "adhesion": _bodies_of(model, np.array(list(actuators.adhesive.values()))),
        "servos": _bodies_of(model, np.array(list(actuators.servos(user_model).values()))),
    }


def _bodies_of(model: newton.Model, links: np.ndarray) -> np.ndarray:
    """The bodies that some links of the user's model belong to."""
    links = links.astype(int)
    bodies = getattr(model, "body_of_link", None)
    return np.unique(links if bodies is None else bodies[links][bodies[links] >= 0])


def _tied_bodies(topology: Topology, only_spatial: bool) -> np.ndarray:
    """Bodies that tendons pull, all of them or spatial ones."""
    found = [
        body
        for closure in topology.closures
        if isinstance(closure.tendon, Tendon) and not (only_spatial and closure.tendon.is_fixed)
        for body in closure.ends
        if body >= 0
    ]
    return np.unique(np.array(found, dtype=int))


def _joints_of(model: newton.Model, bodies: np.ndarray) -> np.ndarray:
    """Joints whose children are some bodies."""
    if bodies.size == 0 or model.joint_count == 0:
        return np.zeros(0, dtype=int)
    return np.flatnonzero(np.isin(model.joint_child.numpy(), bodies))


def _closing_joints(model: newton.Model, topology: Topology, pulled: np.ndarray) -> np.ndarray:
    """Joints that ask for equations beside the trees: their own, or those of tendons."""
    own = [closure.joint for closure in topology.closures if closure.joint >= 0]
    return np.union1d(np.array(own, dtype=int), _joints_of(model, pulled))


def _pushing(model: newton.Model) -> np.ndarray:
    """Joints whose generalized force is a wrench on their child."""
    types = model.joint_type.numpy() if model.joint_count else np.zeros(0)
    return np.flatnonzero(np.isin(types, [int(kind) for kind in PUSHED_AT_COM]))


def free_joints(model: newton.Model) -> np.ndarray:
    """The first joint of each body whose force is a wrench on it, -1 without, (body_count,)."""
    first = np.full(model.body_count, -1)
    pushing = _pushing(model)[::-1]
    if pushing.size:
        first[model.joint_child.numpy()[pushing]] = pushing
    return first


def pushing_joints(model: newton.Model) -> np.ndarray:
    """Joints whose force is such a wrench, and not only that on a body without another one."""
    pushing = _pushing(model)
    if pushing.size == 0:
        return pushing
    is_other = free_joints(model)[model.joint_child.numpy()[pushing]] != pushing
    return pushing[is_other | (model.joint_parent.numpy()[pushing] >= 0)]


def linking_joints(model: newton.Model) -> np.ndarray:
    """Joints that are more than the FREE joint of a body to the world."""
    types = model.joint_type.numpy() if model.joint_count else np.zeros(0)
    return np.union1d(np.flatnonzero(types != _FREE), pushing_joints(model))


@dataclass(frozen=True)
class _Axes:
    """Degrees of freedom of joints that list their axes: not those of FREE joints and the like."""

    model: newton.Model
    dofs: np.ndarray
    joint: np.ndarray
    """Joint of each."""

    @classmethod
    def of_model(cls, model: newton.Model) -> "_Axes":
        if model.joint_count == 0:
            return cls(model, np.zeros(0, dtype=int), np.zeros(0, dtype=int))
        unlisted = (_FREE, int(newton.JointType.ROD), int(newton.JointType.DISTANCE))
        owner = joint_of_dof(model)
        dofs = np.flatnonzero(~np.isin(model.joint_type.numpy()[owner], unlisted))
        return cls(model, dofs, owner[dofs])

    def values(self, name: str) -> np.ndarray:
        """An array of the model, of these axes."""
        return getattr(self.model, name).numpy()[self.dofs] if self.dofs.size else np.zeros(0)

    def joints(self, concerned: np.ndarray) -> np.ndarray:
        """Joints that have one of the axes that a mask selects."""
        return np.unique(self.joint[concerned])

    def driven(self) -> np.ndarray:
        """Which have a drive that could act."""
        gain = self.values("joint_target_ke") + self.values("joint_target_kd")
        passive = (int(newton.JointTargetMode.NONE), int(newton.JointTargetMode.EFFORT))
        return (gain != 0.0) & ~np.isin(self.values("joint_target_mode"), passive)

    def bounded(self) -> np.ndarray:
        """Which have a limit."""
        lower, upper = self.values("joint_limit_lower"), self.values("joint_limit_upper")
        return (lower > -newton.MAXVAL) | (upper < newton.MAXVAL)

    def positive(self, *names: str) -> np.ndarray:
        """Which have one of these coefficients above zero."""
        return np.any([self.values(name) > 0.0 for name in names], axis=0)

    def limited(self, name: str, least: float) -> np.ndarray:
        """Which have such a limit: below Newton's default, which says none."""
        limit = self.values(name)
        return (limit > least) & (limit < NO_LIMIT)


def _colliding(model: newton.Model) -> np.ndarray:
    """Shapes that collide with others; where bodies have variants, all."""
    if model.body_count == 0 or model.shape_count == 0:
        return np.zeros(0, dtype=int)
    if model.body_variant is not None and np.any(model.body_variant.numpy() >= 0):
        return np.arange(model.shape_count)
    return np.flatnonzero(model.shape_flags.numpy() & int(newton.ShapeFlags.COLLIDE_SHAPES))


def _shapes_with(model: newton.Model, name: str) -> np.ndarray:
    """Shapes that collide, with a coefficient of their material above zero."""
    shapes = _colliding(model)
    if shapes.size == 0:
        return shapes
    return shapes[getattr(model, f"shape_material_{name}").numpy()[shapes] > 0.0]


def _frictional(model: newton.Model, condims: Condims) -> np.ndarray:
    """Shapes that collide with friction."""
    found = _shapes_with(model, "mu")
    if condims.condim.size == 0:
        return found
    sliding = np.intersect1d(_colliding(model), np.flatnonzero(condims.slides()))
    if sliding.size == 0:
        return sliding
    return np.union1d(found, np.intersect1d(sliding, condims.pairs))


def _twisting(model: newton.Model, condims: Condims, angular_friction: bool | None) -> np.ndarray:
    """Shapes that collide with torsional or rolling friction that acts."""
    if angular_friction is False:
        return np.zeros(0, dtype=int)
    found = np.intersect1d(_colliding(model), np.flatnonzero(condims.twists()))
    if not angular_friction:
        return found
    for name in ("mu_torsional", "mu_rolling"):
        found = np.union1d(found, _shapes_with(model, name))
    return found


def _put_bodies(model: newton.Model) -> np.ndarray:
    """Bodies that the solver does not move and whose shapes collide."""
    if _colliding(model).size == 0:
        return np.zeros(0, dtype=int)
    is_put = is_kinematic(model)
    is_put |= model.body_inv_mass.numpy() == 0.0
    return np.intersect1d(np.flatnonzero(is_put), model.shape_body.numpy()[_colliding(model)])


def bodies_in_fluid(model: newton.Model) -> np.ndarray:
    """Bodies that move in a world with a fluid of some density or viscosity."""
    found = authored_fluid(model)
    if model.body_count == 0 or found is None:
        return np.zeros(0, dtype=int)
    is_felt = (found.density.numpy() > 0.0) | (found.viscosity.numpy() > 0.0)
    world = np.maximum(model.body_world.numpy(), 0)
    return np.flatnonzero(is_felt[world] & moving(model))


def _dahl_rods(model: newton.Model) -> np.ndarray:
    """Rods with Dahl friction."""
    authored = dahl_friction(model)
    if model.joint_count == 0 or not authored:
        return np.zeros(0, dtype=int)
    is_rod = model.joint_type.numpy() == int(newton.JointType.ROD)
    return np.flatnonzero(is_rod & np.all([v.numpy() > 0.0 for v in authored.values()], axis=0))


def _breakable(model: newton.Model) -> np.ndarray:
    """Joints that break at some force or torque."""
    limits = [~np.isposinf(limit.numpy()) for limit in break_limits(model).values()]
    return np.flatnonzero(np.any(limits, axis=0)) if limits else np.zeros(0, dtype=int)


def _unequal_moments(model: newton.Model) -> np.ndarray:
    """Bodies whose inertia tensor is not a multiple of the identity, beyond rounding."""
    if model.body_count == 0:
        return np.zeros(0, dtype=int)
    inertia = model.body_inertia.numpy().astype(np.float64)
    mean = np.trace(inertia, axis1=1, axis2=2) / 3.0
    off = np.abs(inertia - mean[:, None, None] * np.eye(3)).max(axis=(1, 2))
    return np.flatnonzero(off > 1.0e-5 * mean)


def _needles(model: newton.Model, topology: Topology) -> np.ndarray:
    """Bodies with shapes that collide, without joints, and with next to no moment about an axis."""
    free = np.intersect1d(
        model.shape_body.numpy()[_colliding(model)], np.flatnonzero(topology.is_alone)
    )
    inertia = model.body_inertia.numpy()[free].astype(np.float64)
    moments = np.linalg.eigvalsh(inertia)
    is_needle = moments[:, 0] < NEEDLE * moments.sum(axis=1)
    return free[is_needle & moving(model)[free]]


def _light_links(model: newton.Model, topology: Topology) -> np.ndarray:
    """Bodies with shapes that collide, in trees of so many times their mass, or with next to no
    moment of inertia for their size.

    What a tree hangs on counts as much as the tree. Placeholders of files are such moments: 1e-6
    kg m^2, or zero, which the importer raises to as little.
    """
    hung = topology.joint >= 0
    shapes = _colliding(model)
    if not np.any(hung) or shapes.size == 0:
        return np.zeros(0, dtype=int)
    moves = moving(model)
    mass = np.where(moves, model.body_mass.numpy().astype(np.float64), 0.0)
    block = topology.block_end[topology.rank]
    is_held = ~moves[topology.parent] | (topology.parent < 0)
    whole = np.bincount(block, mass)
    whole *= np.where(np.bincount(block, hung & is_held) > 0, 2.0, 1.0)
    is_tree = np.bincount(block, hung) > 0
    body_of, radius = model.shape_body.numpy()[shapes], model.shape_collision_radius.numpy()[shapes]
    size = np.zeros(mass.size)
    np.maximum.at(size, body_of[body_of >= 0], radius[body_of >= 0])
    moment = 0.5 * np.trace(model.body_inertia.numpy(), axis1=1, axis2=2)
    is_light = (LIGHT_LINK * whole[block] > mass) | (LIGHT_LINK * mass * size**2 > moment)
    touches = np.isin(np.arange(mass.size), body_of)
    return np.flatnonzero(is_tree[block] & touches & moves & is_light)


def _floating(model: newton.Model, topology: Topology, pulled: np.ndarray) -> np.ndarray:
    """Bodies that move, and that something ties to others, but no joint to anything fixed.

    Tendons and cables may do so, and then their islands are none.
    """
    parent, moves = topology.parent, moving(model)
    root = np.where(parent >= 0, parent, np.arange(parent.size))
    while np.any(root != root[root]):
        root = root[root]
    is_fixed = (~moves | (topology.joint >= 0))[root]
    ends = np.zeros((0, 2), dtype=int)
    if topology.loops.size:
        joints = (model.joint_child.numpy(), model.joint_parent.numpy())
        ends = np.stack([of_joint[topology.loops] for of_joint in joints], axis=1)
    is_fixed[root[ends[ends[:, 1] < 0, 0]]] = True
    links = root[ends[ends[:, 1] >= 0]]
    while np.any(meets := is_fixed[links[:, 0]] != is_fixed[links[:, 1]]):
        is_fixed[links[meets]] = True
    is_tied = (parent >= 0) | topology.cabled
    is_tied[np.union1d(ends[:, 0], pulled)] = True
    return np.flatnonzero(is_tied & moves & ~is_fixed[root])


def _light_roots(model: newton.Model, topology: Topology) -> np.ndarray:
    """Bodies that move, that no joint holds, and that carry so much more than themselves."""
    linked = np.flatnonzero(topology.parent >= 0)
    if linked.size == 0:
        return linked
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
    is_light = np.zeros(mass.size, dtype=bool)
    for own, beyond in ((mass, 0.0), (moments, mass[linked] * arm**2)):
        carried = np.bincount(root[linked], own[linked] + beyond, mass.size)
        is_light |= (_LIGHT * carried > own) & moving(model)
    return np.flatnonzero(is_light)

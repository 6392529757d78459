# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Which effects a scene calls for. Kernels hold code for those and no others."""

import dataclasses
import operator
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import newton
import numpy as np

from .model.callers import find_callers
from .model.topology import Topology
from .rows.joint import JointKinds
from .settings import Settings

_MOST_NAMES = 3
"""Labels that a reason names."""


@dataclass(frozen=True)
class Cause:
    """What calls for an effect."""

    by: str
    """What is counted and named where it calls: bodies, joints or shapes; empty for a setting."""
    having: str
    """What of these call; or the setting that does."""
    code: str
    """File of the package that holds what the effect computes."""
    remedy: str = ""
    """What to do instead of leaving it out by ``effects``; empty for what can be left out so."""


_OF_JOINTS = "It follows from the joints; disable those that are to hold nothing (joint_enabled)."
_OF_BODIES = "It follows from the bodies that there are."
_OF_BUFFER = "contact buffer"

CAUSES: dict[str, Cause] = {
    "contact": Cause("shape", "that can collide with others", "rows/contact.py"),
    "pairs": Cause(
        "body", "that could meet another one of the same world", "step/islands.py", _OF_BODIES
    ),
    "floating": Cause(
        "body",
        "tied to others by joints, tendons or cables, and free to float",
        "step/islands.py",
        _OF_JOINTS,
    ),
    "piles": Cause(
        "body",
        "that no joint holds, in a world of several bodies (not with blocks='body')",
        "step/piles.py",
        "Pass blocks='body'.",
    ),
    "mixing": Cause("body", "moved by joints, in a world of several bodies", "step/mixing.py"),
    "cylinders": Cause("shape", "of type CYLINDER, which may roll", "step/rolling.py"),
    "ellipsoids": Cause(
        "shape", "of type ELLIPSOID, which may touch without a normal", "step/ellipsoids.py"
    ),
    "friction": Cause("shape", "with friction (mu) above zero", "rows/contact.py"),
    "angular_friction": Cause(
        "shape",
        "with mu_torsional or mu_rolling above zero, and angular_friction=True or MuJoCo's condim",
        "rows/spin.py",
    ),
    "condim": Cause(
        "shape", "of an MJCF file, or with a condim or priority of MuJoCo's", "rows/condim.py"
    ),
    "contact_pairs": Cause(
        "shape", "of an explicit pair of MuJoCo's (mujoco:pair_*)", "rows/condim.py"
    ),
    "put_bodies": Cause(
        "body", "kinematic or without mass, with shapes and friction", "step/bodies.py"
    ),
    "restitution": Cause(
        "shape", "with restitution above zero, and rigid contacts", "step/impacts.py"
    ),
    "compliance": Cause(
        "", "compliant_contacts=True", "rows/contact.py", "Pass compliant_contacts."
    ),
    "second_order": Cause(
        "",
        "scheme='generalized_alpha', the default, or 'runge_kutta'",
        "step/second_order.py",
        "Pass scheme.",
    ),
    "fourth_order": Cause(
        "joint",
        "moved along free axes by scheme='runge_kutta' or accuracy",
        "step/runge_kutta.py",
        "Pass scheme.",
    ),
    "carried_rounding": Cause(
        "body",
        "stepped by scheme='generalized_alpha', the default, or 'runge_kutta', without contacts, "
        "cables, drag and accuracy",
        "step/carrying.py",
    ),
    "adaptive": Cause("", "accuracy", "step/adapting.py", "Leave accuracy out."),
    "ramp": Cause("", "formulation='ramp'", "rows/ramp.py", "Pass formulation."),
    "sleeping": Cause("", "sleeping=True", "step/sleeping.py", "Pass sleeping."),
    "matching": Cause(_OF_BUFFER, "that matches its contacts", "step/contacts.py"),
    "moving_surfaces": Cause(_OF_BUFFER, "with surface velocities", "step/contacts.py"),
    "contact_materials": Cause(_OF_BUFFER, "with materials for each contact", "step/contacts.py"),
    "gyroscopic": Cause("body", "with unequal principal moments of inertia", "blocks/body.py"),
    "needles": Cause(
        "body",
        "with shapes and no joints, some 20 times as long as thick or thinner",
        "step/needles.py",
    ),
    "joint_force": Cause(
        "joint", "of type FREE, DISTANCE or ROD, whose joint_f pushes a body", "step/bodies.py"
    ),
    "light_roots": Cause(
        "body", "with less than 1e-5 of the mass or inertia carried by joints", "step/eliminate.py"
    ),
    "light_links": Cause(
        "body",
        "with shapes, and less than 1/200 of the mass that joints put behind the contacts, or of "
        "the moment that fits the shapes",
        "step/weights.py",
    ),
    "reaction": Cause(
        "joint",
        "of type FREE, DISTANCE or ROD with a parent body, or not the first of the child",
        "step/bodies.py",
    ),
    "welds": Cause(
        "weld", "of links into one body: FIXED, or D6 without a free axis", "step/links.py"
    ),
    "joints": Cause(
        "joint",
        "of another type than FREE, with a parent body, not the first of the child, or at a body "
        "that a tendon pulls",
        "step/trees.py",
        _OF_JOINTS,
    ),
    "flipped": Cause(
        "joint", "whose child carries the parent in the tree", "step/anchors.py", _OF_JOINTS
    ),
    "loops": Cause("joint", "outside of trees", "step/loops.py", _OF_JOINTS),
    "closures": Cause(
        "joint",
        "to close a loop, bound a distance or mimic within a tree, or at a body that a tendon "
        "pulls",
        "step/closures.py",
        _OF_JOINTS,
    ),
    "mimics": Cause(
        "joint",
        "with another joint to mimic",
        "step/mimics.py",
        "Set joint_mimic_joint to -1, or mujoco:equality_constraint_enabled to False where an "
        "importer made it of such a constraint, before the solver is made.",
    ),
    "equalities": Cause(
        "joint",
        "that an equality constraint of MuJoCo's ties by more than a mimic, such as a polynomial "
        "(equality_constraint_*)",
        "step/mimics.py",
        "Set mujoco:equality_constraint_enabled to False before the solver is made.",
    ),
    "yielding": Cause(
        "joint",
        "of a CONNECT or WELD constraint of MuJoCo's to a link that only the user moves, such as a "
        "mocap body",
        "step/loop_start.py",
    ),
    "drives": Cause(
        "joint",
        "with a drive that has a gain (target_ke, target_kd) and is none of the actuators",
        "rows/axis.py",
    ),
    "effort_limits": Cause(
        "joint", "with a drive of limited effort (effort_limit)", "rows/axis.py"
    ),
    "actuators": Cause(
        "joint",
        "with a MuJoCo actuator (mujoco:actuator_*), with a drive for which one authors more than "
        "gains, or with a limit of the total force of actuators (actuatorfrcrange)",
        "rows/actuator.py",
    ),
    "force_ranges": Cause(
        "joint",
        "with an actuator whose forcerange is not the only limit of the force",
        "rows/axis.py",
    ),
    "limits": Cause("joint", "with a limit (limit_lower, limit_upper)", "rows/axis.py"),
    "limit_impedance": Cause(
        "joint",
        "with a limit of an MJCF file (mujoco:solreflimit, solimplimit), and "
        "compliant_contacts=True",
        "rows/axis.py",
    ),
    "velocity_limits": Cause("joint", "with a velocity_limit", "rows/axis.py"),
    "springs": Cause("joint", "with a passive stiffness or damping", "rows/axis.py"),
    "armature": Cause("joint", "with armature above zero", "rows/axis.py"),
    "joint_friction": Cause("joint", "with friction above zero", "rows/axis.py"),
    "tendons": Cause("body", "that a MuJoCo tendon pulls (mujoco:tendon_*)", "step/tendons.py"),
    "spatial_tendons": Cause(
        "body", "with a site or geom of a spatial MuJoCo tendon", "step/tendons.py"
    ),
    "gravity_compensation": Cause(
        "body", "with gravity compensation (mujoco:gravcomp)", "step/actuation.py"
    ),
    "body_actuators": Cause(
        "body",
        "that a MuJoCo actuator pushes at a site, or along a BALL or FREE joint",
        "step/body_actuators.py",
    ),
    "adhesion": Cause(
        "body", "that a MuJoCo actuator pulls towards contacts (adhesion)", "step/adhesion.py"
    ),
    "servos": Cause(
        "body",
        "that a MuJoCo actuator pushes against the world, depending on how the body moves",
        "step/body_actuators.py",
    ),
    "breaking": Cause(
        "joint", "with a finite joint_break_force or joint_break_torque", "step/breaking.py"
    ),
    "dahl": Cause(
        "joint", "of type ROD with Dahl friction (vbd:dahl_eps_max, dahl_tau)", "rows/dahl.py"
    ),
    "fluid": Cause("body", "in a fluid (mujoco:density, mujoco:viscosity)", "rows/fluid.py"),
    "cables": Cause("tendon", "of Newton's own, a cable (add_tendon)", "rows/cable.py"),
}
"""What calls for each effect, where its code is, and whether a user can leave it out."""

_IMPLIED: dict[str, tuple[str, ...]] = {
    "contact": (
        *("pairs", "piles", "friction", "angular_friction", "put_bodies", "restitution", "ramp"),
        *("light_links", "condim", "contact_pairs", "adhesion", "needles"),
        *("cylinders", "ellipsoids", "mixing"),
    ),
    "gyroscopic": ("needles",),
    "friction": ("put_bodies",),
    "condim": ("contact_pairs",),
    "joint_force": ("reaction",),
    "loops": ("yielding",),
    "drives": ("effort_limits",),
    "limits": ("limit_impedance",),
    "actuators": ("force_ranges",),
    "effort_limits": ("force_ranges",),
    "tendons": ("spatial_tendons",),
    "body_actuators": ("servos",),
}
"""What goes with an effect that is left out."""


@dataclass(frozen=True)
class Effects:
    """The effects that a solver's kernels are compiled with.

    A field says what of the scene its effect stands for; True where the kernels hold its code.
    """

    contact: bool
    """Shapes that collide with others."""
    friction: bool
    """A shape with a friction coefficient above zero."""
    gyroscopic: bool
    """A body whose principal moments of inertia differ."""
    joint_force: bool
    """A joint of type FREE, DISTANCE or ROD, whose generalized force is a wrench on its body."""
    welds: bool = False
    """Links that joints without a free axis make one body."""
    kinds: JointKinds = field(default_factory=JointKinds)
    """The kinds of joints that hold something."""
    reaction: bool = False
    """Such a joint below a body that moves, on which its force reacts."""
    flipped: bool = False
    """A tree that goes from the child of a joint, kinematic or held, to its parent."""
    needles: bool = False
    """A body with shapes whose moment about its long axis is next to nothing."""
    light_roots: bool = False
    """A free body whose joints carry so much more than itself that rounding would move it."""
    light_links: bool = False
    """A body with shapes whose joints put many times its own mass behind its contacts."""
    loops: bool = False
    """Joints outside of trees, which close a loop, or each body is a block of its own."""
    closures: bool = False
    """Joints that close loops within a tree and are solved with it, or mimics."""
    mimics: bool = False
    """A joint that mimics another."""
    equalities: bool = False
    """A joint that follows another one by a polynomial, or that an equality constraint holds."""
    yielding: bool = False
    """A constraint that gives way, to a link that only the user moves."""
    drives: bool = False
    """A joint axis with a drive that has a gain."""
    actuators: bool = False
    """A joint axis with an actuator of MuJoCo's."""
    force_ranges: bool = False
    """An actuator with a force range that shares its axis with others."""
    tendons: bool = False
    """A tendon of MuJoCo's."""
    spatial_tendons: bool = False
    """One that runs through sites."""
    gravity_compensation: bool = False
    """A body whose weight is compensated."""
    body_actuators: bool = False
    """An actuator of MuJoCo's that pushes bodies."""
    adhesion: bool = False
    """One that pulls a body towards what it touches."""
    servos: bool = False
    """One that pushes against the world, by how its body moves."""
    limits: bool = False
    """A joint axis with a limit."""
    limit_impedance: bool = False
    """A compliant limit of a joint axis with MuJoCo's reference and impedance."""
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
    pairs: bool = False
    """Two bodies in a world, which may meet, so that contacts are not all with static shapes."""
    floating: bool = False
    """Bodies that are tied to each other and to nothing that is fixed."""
    compliance: bool = False
    """Contacts and joint limits give way as the stiffness and damping that are authored say."""
    mixing: bool = False
    """A body moved by joints, in a world of several bodies."""
    piles: bool = False
    """Free bodies in contact are solved at once, and a world has two of them."""
    second_order: bool = False
    """Second order in time where the motion is smooth."""
    fourth_order: bool = False
    """Fourth order where nothing but joints holds bodies."""
    carried_rounding: bool = False
    """What rounding takes from poses and velocities goes on to the next step."""
    adaptive: bool = False
    """An accuracy was asked for, which decides on inner steps."""
    ramp: bool = False
    """The seed document's formulation, penalties that grow and no multipliers."""
    sleeping: bool = False
    """Islands at rest are not solved, and each one by itself, where that was asked for."""
    cylinders: bool = False
    """A shape that is a cylinder, which may roll."""
    ellipsoids: bool = False
    """A shape that is an ellipsoid, for which detection may find no normal."""
    friction_mix: str = "geometric_average"
    """How the friction coefficients of two shapes mix."""
    angular_friction: bool = False
    """Asked for, and a shape with torsional or rolling friction."""
    condim: bool = False
    """A shape that MuJoCo's rules of friction are for."""
    contact_pairs: bool = False
    """An explicit pair of MuJoCo's."""
    put_bodies: bool = False
    """Friction, and a body with shapes that the solver does not move."""
    restitution: bool = False
    """A shape with a restitution above zero."""
    matching: bool = False
    """The contact buffer in use says which contact is which."""
    moving_surfaces: bool = False
    """The contact buffer in use has surface velocities."""
    contact_materials: bool = False
    """The contact buffer in use has materials of its own for each contact."""
    dahl: bool = False
    """A rod with Dahl friction."""
    fluid: bool = False
    """A fluid, and a body that moves in it."""
    cables: bool = False
    """A tendon of Newton's own."""
    on_gpu: bool = False
    """What the kernels are compiled for, not an effect of the scene."""

    @classmethod
    def of_model(
        cls,
        model: newton.Model,
        topology: Topology,
        settings: Settings,
        without: frozenset[str] = frozenset(),
    ) -> tuple["Effects", "Callers"]:
        """Reads from the model which effects it calls for; copies model arrays to the host.

        Args:
            model: The model.
            topology: How its joints link its bodies.
            settings: The solver's.
            without: Effects that are to be left out.

        Returns:
            The effects, and what calls for each.
        """
        callers = find_callers(model, topology, settings, without)
        flags = {name: found.size > 0 for name, found in callers.items() if name != "joints"}
        effects = cls(
            **flags,
            kinds=JointKinds.of_model(model),
            compliance=settings.compliant_contacts,
            second_order=settings.second_order,
            ramp=settings.ramp,
            sleeping=settings.sleeping,
            adaptive=settings.accuracy is not None,
            friction_mix=settings.friction_mix_mode or "geometric_average",
            on_gpu=model.device.is_cuda,
        )
        return effects.leaving_out(without), Callers.of_items(model, callers)

    def leaving_out(self, names: frozenset[str]) -> "Effects":
        """These effects less some, and less what goes with those."""
        gone = names.union(*(_IMPLIED.get(name, ()) for name in names))
        if self.actuators and "effort_limits" not in names:
            gone -= {"effort_limits"}  # actuators have limits, too
        off: dict[str, Any] = dict.fromkeys(gone, False)
        return dataclasses.replace(self, **off)

    @property
    def joints(self) -> bool:
        """Whether a joint, tendon or cable holds anything."""
        return bool(self.kinds.angular) or self.reaction or self.tendons or self.cables

    @property
    def drag(self) -> bool:
        """Whether something slows a body down by how it moves itself."""
        return self.fluid or self.servos

    @property
    def inline(self) -> bool | None:
        """Whether the large device functions are inlined; None leaves that to the compiler.

        For a GPU it inlines whatever it can: the solve of all effects takes it more than 40
        minutes. On a CPU functions that are not inlined make the step of a robot 7 % longer.
        """
        return False if self.on_gpu and self.joints else None

    @property
    def islands(self) -> bool:
        """Whether bodies may push each other, or are tied, and push nothing that is fixed."""
        return self.pairs or self.floating

    @property
    def turning_islands(self) -> bool:
        """Whether velocities of islands lack angular momentum, as inertias of bodies turn, or arms
        of a step of second order are those of its end, or because their bodies are not moved."""
        turns = self.gyroscopic or self.second_order or not self.pairs
        return self.islands and turns and not self.drag

    @property
    def centered(self) -> bool:
        """Whether the COM of a free island has to be put back where sweeps are cut off."""
        return self.joints and self.islands and not self.drag

    @property
    def trapezoidal(self) -> bool:
        """Whether steps of backward Euler leave articulations by the trapezoidal rule."""
        return self.second_order and self.joints and not self.pulled

    @property
    def pulled(self) -> bool:
        """Whether more than weight and joints may pull at an articulation that nothing touches."""
        return self.drag or self.cables or self.spatial_tendons

    @property
    def spinning(self) -> bool:
        """Whether linked bodies may turn fast about an axis that matters."""
        return self.gyroscopic and self.joints

    @property
    def tilting(self) -> bool:
        """Whether the spin of a linked body may have to be tilted. (Closures take the matrix of
        their tree to be symmetric, which that would not leave it.)"""
        return self.spinning and not self.closures

    @property
    def rods(self) -> bool:
        """Whether there are ROD joints, elastic along all six axes."""
        return self.kinds.rods

    @property
    def distances(self) -> bool:
        """Whether there are DISTANCE joints."""
        return self.kinds.distances

    @property
    def coordinates(self) -> bool:
        """Whether coordinates of joints count, because something acts along axes that depends on
        them, or because poses alone do not tell them."""
        linear = self.drives or self.springs or self.armature or self.rods or self.limits
        tied = self.mimics or self.tendons
        return linear or self.pushed_axes or self.laws or tied or self.kinds.gimbals

    @property
    def axis_rates(self) -> bool:
        """Whether inertia along joint axes calls for the velocities of their coordinates."""
        return self.armature or self.limit_impedance

    @property
    def pushed_axes(self) -> bool:
        """Whether actuators push along joint axes."""
        return self.actuators

    @property
    def free_balls(self) -> bool:
        """Whether there are ball joints on which nothing acts but what is put on them."""
        alone = not self.coordinates and not self.closures and not self.cables
        return self.kinds.balls and alone

    @property
    def stops(self) -> bool:
        """Whether hard limits of position or velocity stop coordinates."""
        return self.hard_limits or self.velocity_limits

    @property
    def hard_limits(self) -> bool:
        """Whether limits are stops, not springs."""
        return self.limits and not self.compliance

    @property
    def laws(self) -> bool:
        """Whether something that acts along joint axes is not linear in their coordinates."""
        return self.stops or self.joint_friction or self.effort_limits

    @property
    def bounded_axes(self) -> bool:
        """Whether friction, or drives with a limit of effort, push along joint axes."""
        return self.joint_friction or self.effort_limits

    @property
    def recovers_by_duals(self) -> bool:
        """Whether sweeps of the recovery go on from what those before have left of a gap."""
        return self.joints and not (self.compliance or self.ramp)

    @property
    def switching(self) -> bool:
        """Whether velocities may jump, at contacts, at stops, or where a tree is pulled straight.
        Such steps may take more sweeps, which does cables no good."""
        return self.contact or self.stops or (self.joints and not self.cables)

    @property
    def balanced(self) -> bool:
        """Whether sweeps may end before they have settled, and the energy of such steps is
        bounded."""
        return (self.contact or self.joints) and not self.ramp

    @property
    def bracing(self) -> bool:
        """Whether contacts may brace links of a tree against each other."""
        return self.joints and self.pairs and not (self.compliance or self.ramp)

    @property
    def gaining(self) -> bool:
        """Whether bodies may gain energy in steps that have settled."""
        return self.kinds.gimbals or self.bracing or self.restitution

    @property
    def folding(self) -> bool:
        """Whether trees with closed loops may fold either way."""
        return self.loops and self.closures

    @property
    def drift(self) -> bool:
        """Whether something shifts what counts as no slip."""
        by_scheme = self.second_order and self.contact
        return self.moving_surfaces or self.put_bodies or self.restitution or by_scheme

    def for_any_values(self) -> "Effects":
        """These effects and those that other values in the same arrays of the model could ask for.

        What follows from which shapes, joints and bodies there are, or from settings, stays.
        """
        return dataclasses.replace(
            self,
            friction=self.contact,
            gyroscopic=True,
            needles=self.contact,
            light_roots=self.joints,
            light_links=self.joints and self.contact and not self.ramp,
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

    def among(self, names: Mapping[str, str]) -> list[str]:
        """What to call those of some effects, or properties of these, that are on; each once."""
        return list(dict.fromkeys(words for name, words in names.items() if getattr(self, name)))

    def without_contact(self) -> "Effects":
        """The effects of a step in which nothing touches."""
        return self.leaving_out(frozenset({"contact"}))


def left_out(wanted: Mapping[str, bool]) -> frozenset[str]:
    """The effects that a user wants to leave out: those that are False.

    Raises:
        ValueError: If that is no mapping, there is no effect of a name, or it cannot be left out.
    """
    if not isinstance(wanted, Mapping):
        raise ValueError(f"effects must be a mapping like {{'friction': False}}, got {wanted!r}.")
    for name, value in wanted.items():
        if name not in CAUSES:
            raise ValueError(f"effects has {name!r}; there are only {', '.join(CAUSES)}.")
        if not value and CAUSES[name].remedy:
            raise ValueError(
                f"effects={{{name!r}: False}}: it cannot be left out so. {CAUSES[name].remedy}"
            )
    return frozenset(name for name, value in wanted.items() if not value)


@dataclass(frozen=True)
class Callers:
    """What in a model calls for its effects: how many and the labels of a few, by effect."""

    counts: Mapping[str, int] = field(default_factory=dict)
    labels: Mapping[str, list[str]] = field(default_factory=dict)

    @classmethod
    def of_items(cls, model: newton.Model, items: Mapping[str, np.ndarray]) -> "Callers":
        """Callers from the indices of bodies, joints or shapes, by effect."""

        def named(name: str) -> list[str]:
            labels = getattr(model, f"{CAUSES[name].by}_label", ())
            return [labels[i] for i in items[name][:_MOST_NAMES]]

        return cls(
            {name: found.size for name, found in items.items()}, {n: named(n) for n in items}
        )

    def describe(self, name: str) -> str:
        """ "4 shapes with friction (mu) above zero: 'a', 'b', 'c', ..." """
        cause, count = CAUSES[name], self.counts.get(name, 0)
        if cause.by in ("", _OF_BUFFER):
            return f"{cause.by} {cause.having}".strip()
        if count == 0:
            return f"no {cause.by} {cause.having}"
        many = "bodies" if cause.by == "body" else f"{cause.by}s"
        names = ", ".join(map(repr, self.labels[name]))
        more = ", ..." if count > _MOST_NAMES else ""
        return f"{count} {cause.by if count == 1 else many} {cause.having}: {names}{more}"

    def require(self, names: Iterable[str], effects: Effects) -> None:
        """Checks that some effects are among those of the model.

        Raises:
            ValueError: If one is not, or another one that is left out takes it along.
        """
        for name in names:
            cause = CAUSES[name]
            if cause.by == _OF_BUFFER:
                why = f"each step has it for a {self.describe(name)}; it can only be left out."
            elif getattr(effects, name):
                continue
            elif self.counts.get(name, 0):
                why = "it goes with another effect that is left out."
            else:
                why = f"nothing calls for it: {cause.remedy or self.describe(name)}"
            raise ValueError(f"effects={{{name!r}: True}}: {why}")


@dataclass(frozen=True)
class Effect:
    """One effect of a scene."""

    on: bool
    """Whether the kernels hold its code."""
    why: str
    """What calls for it, or that nothing does, or that it was left out."""
    bytes: int
    """Memory of the solver that only it needs [bytes]."""


@dataclass(frozen=True)
class SceneEffects(Mapping[str, Effect]):
    """Every effect, on or off, why, and what it costs; prints as a table.

    A mapping from an effect's name to its :class:`Effect`. A name that is no effect raises a
    KeyError.
    """

    flags: Effects
    """What the kernels are compiled with; equal flags share kernels."""
    effects: Mapping[str, Effect]
    """The same effects, by name."""
    always: int
    """Memory that every solver of so many bodies needs [bytes]."""

    @classmethod
    def of_solver(
        cls, flags: Effects, callers: Callers, without: frozenset[str], memory: Mapping[str, int]
    ) -> "SceneEffects":
        """Puts together flags, reasons and memory [bytes] by effect; ``""`` is for all scenes'."""
        gone = without.union(*(_IMPLIED.get(name, ()) for name in without))

        def explained(name: str) -> Effect:
            on, why = getattr(flags, name), callers.describe(name)
            if name in gone and callers.counts.get(name, 1):
                why = f"left out by the user; {why}"
            elif on and not callers.counts.get(name, 1):
                why = f"a graph may call for it; so far {why}"
            elif not on and CAUSES[name].by in ("", _OF_BUFFER):
                why = f"no {why}" if CAUSES[name].by else f"without {why}"
            return Effect(on, why, memory.get(name, 0))

        return cls(flags, {name: explained(name) for name in CAUSES}, memory.get("", 0))

    def __getitem__(self, name: str) -> Effect:
        return self.effects[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self.effects)

    def __len__(self) -> int:
        return len(self.effects)

    def as_dict(self) -> dict[str, dict[str, bool | str | int]]:
        """Plain values: ``on``, ``why`` and ``bytes`` [bytes] by effect, as JSON can hold them."""
        return {name: dataclasses.asdict(effect) for name, effect in self.items()}

    def __str__(self) -> str:
        """A table, what is on first."""
        rows = [
            (name, "on" if effect.on else "off", f"{effect.bytes:,}", effect.why)
            for name, effect in sorted(self.items(), key=lambda item: not item[1].on)
        ]
        rows = [("effect", "", "bytes", "why"), *rows]
        rows.append(("in every scene", "", f"{self.always:,}", "bodies and worlds"))
        widths = [max(len(row[i]) for row in rows) for i in range(3)]
        return "\n".join(
            f"{name:<{widths[0]}}  {on:<{widths[1]}}  {size:>{widths[2]}}  {why}"
            for name, on, size, why in rows
        )

# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""What a step works on: the structs that kernels read and write.

Who owns what, and what always holds:

- A *body slot* is a body index; slot ``body_count`` is the static world, which never moves.
- A *world* here is a group of bodies that one thread solves. It is a Newton world, or all bodies
  at once where mobile global bodies (``body_world == -1``), or with error control any global
  bodies, tie the worlds together; global bodies that do not move otherwise make a world of their
  own, which passes them through.
- A contact row has an *owner*, body ``a``: the first of its mobile bodies in visiting order. The
  rows of a world are sorted by owner, so that a body finds the rows it owns side by side in
  ``rows[owned_start[b]:owned_end[b]]`` and the rows in which it is ``b`` through
  ``other_rows[other_start[b]:other_end[b]]``.
- What is kept between steps (the *history*) has two sides; a step reads side ``parity`` and
  writes side ``1 - parity``, or with error control one of two others. The parity lives on the
  device, so that a captured graph may hold any number of steps.
"""

from typing import Any, NamedTuple

import warp as wp

from .algebra.block import BlockFactor

vec5 = wp.types.vector(length=5, dtype=wp.float32)
vec6 = wp.types.vector(length=6, dtype=wp.float32)
vec10 = wp.types.vector(length=10, dtype=wp.float32)


@wp.struct
class ContactRow:
    """One contact during one step, linearised at the poses in ``state_in``; 64 bytes."""

    normal: wp.vec3
    """Unit normal, world frame, from body a to body b."""
    arm: wp.vec3
    """From the COM of body a to the contact point [m], world frame; the arm of b adds its span."""
    force: wp.vec3
    """Multiplier: the force on body b [N], world frame."""
    k_n: float
    """Penalty along the normal [N/m]."""
    k_t: float
    """Penalty across the normal [N/m]."""
    mu: float
    """Friction coefficient."""
    gap: float
    """Separation at the start of the step [m]; negative is penetration."""
    a: int
    """Slot of the owner."""
    b: int
    """Slot of the other body."""
    contact: int
    """The contact's index; its bitwise complement where a and b are exchanged."""


@wp.struct
class SpinRow:
    """Torsional and rolling friction of one contact during one step."""

    torque: wp.vec3
    """Multiplier: the torque on body b [N m], world frame."""
    k_twist: float
    """Penalty about the normal [N m/rad]."""
    k_roll: float
    """Penalty across the normal [N m/rad]."""
    mu_twist: float
    """Most torque about the normal by normal force [m]."""
    mu_roll: float
    """Most torque across the normal by normal force [m]."""


@wp.struct
class Impact:
    """What restitution does to one contact row during one step."""

    mass: float
    """Effective mass along the normal [kg]."""
    restitution: float
    goal: float
    """Speed at which the bodies are to part at the end of the current round [m/s]; negative for a
    row that takes no part in it."""
    impulse: float
    """Normal impulse of the current round [N s]."""
    total: float
    """Normal impulse of all rounds [N s]; zero for a row that does not bounce."""
    acceleration: float
    """At which the bodies would part without constraints [m/s^2]."""
    wait: float
    """When the bodies meet, from the start of the step [s]."""
    lag: float
    """How far velocities lagged behind the parabola until then, as :attr:`WorldScale.lag`."""
    gap: float
    """Separation at the start of the step [m]; the row of a bounce counts from the impact."""
    drift: wp.vec3
    """What surfaces carry, without the bounce [m]."""
    force: wp.vec3
    """Force on body b in the step [N]."""
    torque: wp.vec3


@wp.struct
class ContactRecord:
    """What is remembered of a contact, to find it again in the next step."""

    shape0: int
    shape1: int
    point0: wp.vec3
    """Contact point on shape 0 [m], body frame, without the radius or margin."""
    point1: wp.vec3
    force: wp.vec3
    """Multiplier: the force on body b [N], world frame."""
    penalty: float
    """Penalty [N/m], which the ramped formulation carries over."""


@wp.struct
class FluidBox:
    """The box of a link that feels a fluid (:mod:`.rows.fluid`)."""

    edges: wp.vec3
    """Edges along its axes [m]."""
    axes: wp.mat33
    """Principal axes of the link, as columns, in the frame of the body."""
    arm: wp.vec3
    """From the COM of the body to that of the link [m], body frame."""


@wp.struct
class FluidModel:
    """A fluid that all bodies are in, and what of them it meets."""

    density: wp.array[float]
    """By world [kg/m^3], read live."""
    viscosity: wp.array[float]
    """By world [Pa s]."""
    wind: wp.array[wp.vec3]
    """Velocity of the fluid by world [m/s]."""
    box_start: wp.array[wp.int32]
    """By body: first of its boxes."""
    boxes: wp.array[FluidBox]


@wp.struct
class Drag:
    """Drag of a fluid and of servos on a body in one step, linear in the velocity at its end:
    push - D v, world axes."""

    ll: wp.mat33
    """D, of forces by velocities [N s/m]."""
    al: wp.mat33
    """Of torques by velocities [N s]."""
    aa: wp.mat33
    """Of torques by angular velocities [N m s]."""
    push: wp.spatial_vectorf
    """[N, N m]."""


@wp.struct
class ActuatorLaw:
    """Force of an actuator: force - stiffness l - damping v, clamped, and what is not clamped,
    ``own_force`` - ``own_damping`` v; see :mod:`.rows.actuator`."""

    force: float
    stiffness: float
    damping: float
    least: float
    most: float
    own_force: float
    own_damping: float


@wp.struct
class BodyPush:
    """What a MuJoCo actuator pushes bodies with in one step, by how its transmission moves."""

    law: ActuatorLaw
    length: float
    """Of the transmission at the start of the step [m or rad]."""
    velocity: float
    """Its rate there [m/s or rad/s]."""
    along: wp.vec3
    """Force on the link by a unit of the actuator's, world frame."""
    about: wp.vec3
    """Torque on it [N m], at ``point``."""
    point: wp.vec3
    """Where it pushes [m]."""
    against: wp.vec3
    """Where it pushes the other body the other way [m]."""
    arm: wp.vec3
    """From the COM of the link to ``point`` [m]."""
    force: float
    """What it pushes with in the step [N or N m]; a servo with that less ``slope`` times the
    velocity of its transmission at the end."""
    slope: float
    """[N s/m or N m s/rad]"""


@wp.struct
class AxisInput:
    """What a controller pushed a degree of freedom with in the last step; second order."""

    push: float
    """What did not depend on the motion [N or N m]."""
    target: float
    """Of the drive [m or rad]."""
    speed: float
    """Target velocity of the drive [m/s or rad/s]."""
    bound_push: float
    """What limited actuators pushed with, whatever the motion [N or N m]."""
    bound_force: float
    """What drive and limited actuators would have pushed with, had they no limit [N or N m]."""
    ahead: wp.vec2
    """How much more than all that the step counted, and its slope [N or N m]."""
    share: float
    """Share of the inertia in what resisted along the axis."""
    mobility: float
    """One over that inertia [1/kg or 1/(kg m^2)]."""


@wp.struct
class Servos:
    """Actuators that push bodies against the world, and by how these move, by body."""

    start: wp.array[wp.int32]
    """First of the servos of each body."""
    items: wp.array[wp.int32]
    """Actuator, an entry of ``pushes``."""
    links: wp.array[wp.int32]
    """Its link."""
    arms: wp.array[wp.vec3]
    """By link: from the COM of the body to that of the link [m], body frame."""
    pushes: wp.array[BodyPush]
    input: wp.array[AxisInput]
    """Second order: what each pushed with in the last step, in the order of ``items``, kept."""
    slopes: wp.array[wp.vec2]
    """And its stiffness and damping then [N/m and N s/m, or by angles], kept."""


@wp.struct
class BodyModel:
    """The model's bodies, read live."""

    mass: wp.array[float]
    inertia: wp.array[wp.mat33]
    inv_mass: wp.array[float]
    inv_inertia: wp.array[wp.mat33]
    com: wp.array[wp.vec3]
    flags: wp.array[wp.int32]
    world: wp.array[wp.int32]
    gravity: wp.array[wp.vec3]
    free_joint: wp.array[wp.int32]
    """The body's first FREE, DISTANCE or ROD joint, -1 without one."""
    free_dof: wp.array[wp.int32]
    """First degree of freedom of that joint, -1 without one."""
    joint_enabled: wp.array[wp.bool]
    fluid: FluidModel
    servos: Servos


@wp.struct
class JointModel:
    """The model's joints, read live."""

    type: wp.array[wp.int32]
    parent: wp.array[wp.int32]
    """Parent body; -1 for the world."""
    child: wp.array[wp.int32]
    parent_frame: wp.array[wp.transform]
    """Anchor frame on the parent, in its body frame."""
    child_frame: wp.array[wp.transform]
    enabled: wp.array[wp.bool]
    """Joints that hold: enabled in the model, and not broken."""
    axis: wp.array[wp.vec3]
    """Axis of each degree of freedom, in the parent anchor frame."""
    dof_start: wp.array[wp.int32]
    dof_dim: wp.array2d[wp.int32]
    """Free linear and angular axes of each joint, shape (joint_count, 2)."""
    coord_start: wp.array[wp.int32]
    target_mode: wp.array[wp.int32]
    target_ke: wp.array[float]
    """Drive stiffness [N/m or N m/rad]."""
    target_kd: wp.array[float]
    """Drive damping [N s/m or N m s/rad]."""
    limit_lower: wp.array[float]
    """Limits of the coordinate [m or rad]."""
    limit_upper: wp.array[float]
    limit_ke: wp.array[float]
    """Stiffness of the limits [N/m or N m/rad], where they are compliant."""
    limit_kd: wp.array[float]
    limit_mobility: wp.array[float]
    """Inverse inertia of an axis in the reference pose [1/kg or 1/(kg m^2)], MuJoCo's
    ``dof_invweight0``; 0 where its limit gives way by ``limit_ke`` and ``limit_kd``."""
    limit_rates: wp.array[wp.vec2]
    """Stiffness [1/s^2] and damping [1/s] by which MuJoCo's reference returns to a limit."""
    limit_impedance: wp.array[vec5]
    """MuJoCo's ``solimplimit``."""
    limit_margin: wp.array[float]
    """How far before its end a limit begins to act [m or rad]."""
    rest_q: wp.array[float]
    """Joint coordinates at which rods and passive springs are at rest."""
    mimic_coefficients: wp.array[wp.vec2]
    """Offset and multiplier by which a mimic joint follows its leader."""
    polynomials: wp.array2d[float]
    """Five coefficients, from the constant one, of each equality constraint of MuJoCo's."""
    damping: wp.array[float]
    """Passive damping [N s/m or N m s/rad]."""
    stiffness: wp.array[float]
    """Passive spring [N/m or N m/rad]."""
    armature: wp.array[float]
    """Inertia reflected to the coordinate [kg or kg m^2]."""
    friction: wp.array[float]
    """Coulomb friction [N or N m]."""
    effort_limit: wp.array[float]
    """Most that a drive pushes with [N or N m]."""
    velocity_limit: wp.array[float]
    """Most that a coordinate changes [m/s or rad/s]."""
    break_force: wp.array[float]
    """Force at which a joint breaks [N]; empty where none does."""
    break_torque: wp.array[float]
    """Torque at which a joint breaks [N m]."""
    dahl_eps_max: wp.array[float]
    """Dahl friction of rods: most torque by stiffness [rad]; empty where none has any."""
    dahl_tau: wp.array[float]
    """Angle over which it tends to that [rad]."""


@wp.struct
class LinkModel:
    """The links of the user's model, and the bodies that welds make of them.

    See :mod:`.model.welds`.
    """

    body: wp.array[wp.int32]
    """Body of each link; -1 for one that is part of the static world."""
    frame: wp.array[wp.transform]
    """Pose of each link in the frame of its body, or in the world."""
    arm: wp.array[wp.vec3]
    """From the COM of the body to that of the link [m], body frame."""
    com: wp.array[wp.vec3]
    """The model's arrays of links."""
    mass: wp.array[float]
    inertia: wp.array[wp.mat33]
    inv_mass: wp.array[float]
    inv_inertia: wp.array[wp.mat33]
    flags: wp.array[wp.int32]
    known_com: wp.array[wp.vec3]
    """What bodies of several links were weighed by."""
    known_mass: wp.array[float]
    known_inertia: wp.array[wp.mat33]
    token_mass: wp.array[float]
    """By body: mass [kg] and moment of inertia [kg m^2] of one that has none, 0 without."""
    token_moment: wp.array[float]
    is_free: wp.array[wp.bool]
    """By body: whether it may move."""
    leader: wp.array[wp.int32]
    """By body: the link whose frame is the body's."""
    member_start: wp.array[wp.int32]
    """By body: first of its links in ``members``."""
    members: wp.array[wp.int32]
    """Links of the bodies, one body's after the other's, and then those of the static world."""
    push_start: wp.array[wp.int32]
    """By body: first of the joints that push it at the COM of a link, and not at its own."""
    pushed: wp.array[wp.int32]
    """That link."""
    push_joint: wp.array[wp.int32]
    push_dof: wp.array[wp.int32]
    push_sign: wp.array[float]
    """1 on the child of such a joint, -1 on its parent."""
    joint: wp.array[wp.int32]
    """Index in the model of each joint that the solver knows; those that it lacks count on."""
    enabled_in: wp.array[wp.bool]
    """The model's array of joints."""
    enabled: wp.array[wp.bool]
    """By joint that the solver knows."""
    joint_parent: wp.array[wp.int32]
    """The model's arrays of joints; empty where the solver has none of its own."""
    joint_child: wp.array[wp.int32]
    parent_frame_in: wp.array[wp.transform]
    child_frame_in: wp.array[wp.transform]
    parent_frame: wp.array[wp.transform]
    """By joint that the solver knows: anchor frames on bodies."""
    child_frame: wp.array[wp.transform]
    body_q: wp.array[wp.transform]
    """State of the bodies at the start of the step, and the external wrenches on them."""
    body_qd: wp.array[wp.spatial_vector]
    body_f: wp.array[wp.spatial_vector]
    body_q_out: wp.array[wp.transform]
    """State at its end."""
    body_qd_out: wp.array[wp.spatial_vector]
    left_qd: wp.array[wp.spatial_vector]
    """Velocity that the last step gave each link."""


@wp.struct
class LinkLoads:
    """What welds carry, found on demand."""

    link: wp.array[wp.spatial_vector]
    """By link: wrench that joints have to give it, about its COM [N, N m]."""
    order: wp.array[wp.int32]
    """Links that a weld ties to the next one towards the root of their body, farthest first."""
    towards: wp.array[wp.int32]
    """By link: that next link; -1 for the world."""
    weld: wp.array[wp.int32]
    """By link: that weld, a joint of the model; -1 at a root."""


@wp.struct
class MotorState:
    """Activations of a DC motor; of those that it has not got zero."""

    control: float
    """Control that the slew rate lets through."""
    integral: float
    """Integral of the position error [rad s or m s]."""
    warmth: float
    """Temperature above that around the motor [K]."""
    bristle: float
    """Deflection of LuGre friction [rad or m]."""
    current: float
    """In the winding [A]."""


@wp.struct
class ActuatorModel:
    """MuJoCo's actuators, arrays of the ``mujoco`` namespace read live, and their activation."""

    dynamics: wp.array[wp.int32]
    gain: wp.array[wp.int32]
    bias: wp.array[wp.int32]
    dynprm: wp.array[vec10]
    gainprm: wp.array[vec10]
    biasprm: wp.array[vec10]
    velocity_bias: wp.array[float]
    """What stands for a ``biasprm[2]`` above zero: what a damping ratio there comes to."""
    gear: wp.array[vec6]
    limits: wp.array[wp.int32]
    """Which of control (1), force (2) and activation (4) are clamped."""
    ctrlrange: wp.array[wp.vec2]
    forcerange: wp.array[wp.vec2]
    actrange: wp.array[wp.vec2]
    lengthrange: wp.array[wp.vec2]
    acc0: wp.array[float]
    """Acceleration of the transmission by a unit force in the reference pose, for muscles."""
    actearly: wp.array[wp.bool]
    damping: wp.array[float]
    dampingpoly: wp.array[wp.vec2]
    activation: wp.array[float]
    """The solver's own state."""
    inputs: wp.array[wp.int32]
    """What the control of a DC motor is: position (1), velocity (2), or voltage (8)."""
    motor: wp.array[MotorState]
    """State of DC motors, the solver's own; empty where there are none."""
    crank: wp.array[float]
    """Length of the rod of slider-cranks [m]."""
    is_reported: wp.array[wp.bool]
    """Whether it has been said that the control is not finite."""


@wp.struct
class AxisPush:
    """What actuators push a joint axis with in the step, by its coordinate q and its velocity v.

    It is force - stiffness q - damping v, and drive - drive_stiffness q - drive_damping v, which
    together with the joint's drive stays between ``least`` and ``most`` [N or N m].
    """

    force: float
    stiffness: float
    damping: float
    drive: float
    drive_stiffness: float
    drive_damping: float
    least: float
    most: float
    first: int
    """First of the laws in :attr:`ControlInput.ranged` that go with the latter, and how many."""
    count: int
    level: float
    """Sum of all that these laws have changed by at the starts of steps [N or N m]."""
    resisted: float
    """What they resisted motion with in the last step, and now, by h^2 [kg or kg m^2]."""
    resists: float
    turned: wp.vec2
    """What force and drive gain at the start of the step by slopes that are no longer those of the
    last one, as a muscle's are, and which their motion takes from them again [N or N m]."""


@wp.struct
class AxisActuation:
    """Actuators that push joint axes, by axis that has some."""

    dof: wp.array[wp.int32]
    """Degree of freedom of the axis."""
    coordinate: wp.array[wp.int32]
    """Its joint coordinate."""
    start: wp.array[wp.int32]
    """First of the actuators of each axis."""
    rows: wp.array[wp.int32]
    """By actuator; -1 of a drive for which no row authors anything."""
    kind: wp.array[wp.int32]
    """Whether it has a control or is a drive; see :mod:`.rows.actuator`."""
    mode_in: wp.array[wp.int32]
    """The model's arrays, by degree of freedom: modes of drives, and armature."""
    armature_in: wp.array[float]
    is_drive: wp.array[wp.bool]
    """By degree of freedom: whether its drive is an actuator; empty where none is."""
    mode: wp.array[wp.int32]
    """Modes of the drives that are no actuators; empty where all are none."""
    added: wp.array[float]
    """What actuators add to the armature of each degree of freedom; empty where that is nothing."""
    armature: wp.array[float]
    """The sum."""
    transmitted: wp.array[float]
    """By degree of freedom: what actuators of tendons and of bodies bring to it at the start of the
    step, where limits of axes bound that, too [N or N m]; empty where they do not."""


@wp.struct
class BodyActuation:
    """Actuators that push bodies: at sites, and along BALL and FREE joints; by actuator."""

    row: wp.array[wp.int32]
    frame: wp.array[wp.transform]
    """Where on its link it pushes, the axes of its gear."""
    link: wp.array[wp.int32]
    reference: wp.array[wp.transform]
    """Of what it pushes against: on the link ``against``, or in the world."""
    against: wp.array[wp.int32]
    """Link that gets the reaction, -1 for the world."""
    axes: wp.array[wp.int32]
    """Whose axes the gear is in; see :mod:`.step.actuation`."""
    is_servo: wp.array[wp.bool]
    """Whether it is one of the :class:`Servos`."""
    pushes: wp.array[BodyPush]


@wp.struct
class Adhesion:
    """Actuators that pull a body towards what it touches."""

    row: wp.array[wp.int32]
    link: wp.array[wp.int32]
    """The body's link."""
    force: wp.array[float]
    """Of each of its contacts in the step [N]."""


@wp.struct
class ControlInput:
    """What drives the joints in the step."""

    pushes: wp.array[AxisPush]
    """What actuators push each degree of freedom with; empty without any."""
    ranged: wp.array[ActuatorLaw]
    """Actuators with force ranges that share their axis, by its coordinate and its velocity."""

    joint_f: wp.array[float]
    """Generalized force on each degree of freedom [N or N m]."""
    target_q: wp.array[float]
    """Drive target, in the layout of the joint coordinates [m or rad]."""
    target_qd: wp.array[float]
    """Drive target velocity [m/s or rad/s]."""


@wp.struct
class ShapeModel:
    """The model's shapes and their materials, read live."""

    body: wp.array[wp.int32]
    frame: wp.array[wp.transform]
    """Pose of each shape's link in the frame of its body; empty where every link is a body."""
    type: wp.array[wp.int32]
    """What it is, a ``newton.GeoType``."""
    pose: wp.array[wp.transform]
    """Its pose in the frame of its link."""
    scale: wp.array[wp.vec3]
    """Its size [m]; of a cylinder the radius and half of the length."""
    mu: wp.array[float]
    """Friction coefficient."""
    mu_torsional: wp.array[float]
    """Torsional friction: torque about the normal by normal force [m]."""
    mu_rolling: wp.array[float]
    """Rolling friction: torque across the normal by normal force [m]."""
    restitution: wp.array[float]
    ke: wp.array[float]
    """Contact stiffness [N/m]."""
    kd: wp.array[float]
    """Contact damping [N s/m]."""
    condim: wp.array[wp.int32]
    """What contacts resist, as MuJoCo counts it; negative for a shape that is not MuJoCo's, two of
    which mix their friction by Newton's rule. Empty where no shape is MuJoCo's."""
    priority: wp.array[wp.int32]
    """Of two shapes the one of the higher priority decides."""
    pair_start: wp.array[wp.int32]
    """By shape: first of the explicit pairs with a shape of a higher index."""
    pair_other: wp.array[wp.int32]
    """By explicit pair: that shape."""
    pair_friction: wp.array[wp.vec3]
    """Sliding, torsional [m], rolling [m]."""
    pair_margin: wp.array[float]
    margin: wp.array[float]
    """Margin of each shape [m]; empty without pairs."""


@wp.struct
class ContactInput:
    """The contact buffer of the step, as Newton's collision pipeline fills it."""

    count: wp.array[wp.int32]
    capacity: int
    shape0: wp.array[wp.int32]
    shape1: wp.array[wp.int32]
    point0: wp.array[wp.vec3]
    point1: wp.array[wp.vec3]
    normal: wp.array[wp.vec3]
    margin0: wp.array[float]
    margin1: wp.array[float]
    surface_velocity: wp.array[wp.vec3]
    """Velocity of surface 1 against surface 0 [m/s], world frame; empty where none moves."""
    stiffness: wp.array[float]
    """Overrides the materials' stiffness [N/m] where above zero; empty where none is given."""
    damping: wp.array[float]
    friction: wp.array[float]
    """Scales the materials' friction where above zero."""
    generation: wp.array[wp.int32]
    buffer: int
    """Number of the buffer [1, 2, ...]; generations of different buffers do not compare."""
    match_index: wp.array[wp.int32]
    """Row of the same contact in the buffer's previous filling; empty without contact matching."""
    match_generation: wp.array[wp.int32]


@wp.struct
class MixedBody:
    """What :mod:`.step.mixing` remembers of the last sweeps of a body, (dx [m], dtheta [rad])."""

    start: wp.spatial_vectorf
    """Increment that the last sweep started from."""
    end: wp.spatial_vectorf
    """Increment that it led to."""
    update: wp.spatial_vectorf
    """Their difference."""
    shift: wp.spatial_vectorf
    """How far the end was from that of the sweep before."""
    change: wp.spatial_vectorf
    """How far the update was from that of the sweep before."""


@wp.struct
class MixedRow:
    """Likewise of the multiplier of a contact row [N]."""

    start: wp.vec3
    end: wp.vec3
    update: wp.vec3
    shift: wp.vec3
    change: wp.vec3


@wp.struct
class BodyWork:
    """Per body slot: the unknowns of the step and what they are pulled to, body_count + 1 long."""

    com: wp.array[wp.vec3]
    """COM at the start of the step [m]."""
    inv_mass: wp.array[float]
    """1/mass [1/kg]; zero for a body that the solver does not move."""
    inertia: wp.array[wp.mat33]
    """Inertia about the COM, world axes [kg m^2]."""
    inv_inertia: wp.array[wp.mat33]
    target: wp.array[wp.spatial_vector]
    """Inertial target of the pose increment: (dx* [m], dtheta* [rad])."""
    increment: wp.array[wp.spatial_vector]
    """The unknowns: (dx [m], dtheta [rad]) from the pose in state_in."""
    momentum: wp.array[wp.vec3]
    """Angular momentum at the end of the step without constraints [N m s], world axes; where bodies
    have unequal principal moments, or velocities of islands are turned."""
    spin_momentum: wp.array[wp.vec3]
    """Angular momentum [N m s] that a linked body resists tilting with, once it turns fast; zero
    for others."""
    finite: wp.array[wp.int32]
    """1 when the body's input is finite."""
    pose: wp.array[wp.transform]
    """Pose at the start of the step: that of state_in, its quaternion of unit length."""
    factor: wp.array[BlockFactor]
    put: wp.array[wp.spatial_vector]
    """Put bodies: how far a pose that was written without a velocity has moved the body since the
    last step, (dx [m], dtheta [rad]); zero for others."""
    put_from: wp.array[wp.transform]
    """Put bodies: pose of the last step where that had no velocity; all zeros otherwise."""
    wrench: wp.array[wp.spatial_vector]
    """Second order: external force [N] and torque [N m], without gravity."""
    lead: wp.array[wp.spatial_vector]
    """Second order: increment (dx [m], dtheta [rad]) from which the step's velocity counts."""
    coasting: wp.array[wp.spatial_vector]
    """Second order: increment of a body that nothing accelerates."""
    gained: wp.array[wp.spatial_vector]
    """Carried rounding: what a velocity gains in the step [m/s, rad/s] by all but constraints; from
    the end of the motion on, how much more it has gained than the states tell."""
    rounded: wp.array[wp.spatial_vector]
    """Carried rounding: what rounding took from the increment of a body of a tree in the last sweep
    (dx [m], dtheta [rad])."""
    input_energy: wp.array[float]
    """Second order: twice the energy that changes of what a controller pushes the body's tree with
    give in a step [J]."""
    drag: wp.array[Drag]
    """In a fluid or held by servos: what slows the body down."""
    mixed: wp.array[MixedBody]
    """Where links may push what moves."""


@wp.struct
class Segment:
    """Memory that belongs to one world."""

    address: wp.uint64
    copy: wp.uint64
    """Where its copy lies, in :attr:`InnerWork.store`."""
    size: int
    """Its length [bytes]."""


@wp.struct
class InnerWork:
    """Error control: a call in inner steps; see :mod:`.step.adapting`."""

    accuracy: float
    """Error that is allowed, per time [m/s]."""
    budget: int
    """Most inner steps of a call, with those that are repeated."""
    pose: wp.array[wp.transform]
    """By body: state at the start of the inner step."""
    velocity: wp.array[wp.spatial_vector]
    wrench: wp.array[wp.spatial_vector]
    """The call's ``body_f``."""
    start: wp.array[wp.transform]
    """Pose at the start of the call."""
    put: wp.array[wp.spatial_vector]
    """Put bodies: how far they were put since the last call."""
    owned_end: wp.array[wp.int32]
    """By body slot: end of the contacts that it owns, those out of reach with the others."""
    contact_f: wp.array[wp.spatial_vector]
    """By contact: mean of its wrench over the call [N, N m]."""
    first: wp.array[wp.int32]
    """First of each world's segments of memory that a step overwrites, shape (world_count + 1,)."""
    pushing: wp.array[wp.int32]
    """Joints that push more than the child that is predicted with them, world by world."""
    pushing_start: wp.array[wp.int32]
    """First of each world's, shape (world_count + 1,)."""
    segments: wp.array[Segment]
    store: wp.array[wp.uint8]
    """What these held at the start of the inner step."""
    steps: wp.array[wp.int32]
    """By world: inner steps of the last call."""
    rejected: wp.array[wp.int32]
    """How many more were repeated in it."""
    estimate: wp.array[float]
    """Error that was estimated in it, per time [m/s]."""
    worst: wp.array[wp.int32]
    """Body with the largest share of what was allowed; -1 where nothing moved."""
    cause: wp.array[wp.int32]
    """Why, see :data:`.step.local_error.SMOOTHLY`."""
    spent: wp.array[float]
    """Error that was estimated since the last reset [m]."""
    missed: wp.array[wp.int32]
    """Calls since then that would have taken more inner steps than they may have."""


@wp.struct
class WorldWork:
    """Per world: which bodies and which contacts it holds, and what became of it."""

    body_start: wp.array[wp.int32]
    bodies: wp.array[wp.int32]
    """Bodies of all worlds in visiting order, shape (body_count,)."""
    block_end: wp.array[wp.int32]
    """By position in ``bodies``: end of the block that the body belongs to, a tree or one body."""
    rank: wp.array[wp.int32]
    """Position of each body slot in ``bodies``."""
    of_body: wp.array[wp.int32]
    """World of each body slot; -1 for the static world."""
    turn: wp.array[wp.int32]
    """On a GPU: world of each thread, -1 for none, in the order of their size, so that those of
    neighboring threads, which wait for each other, are alike."""
    held: wp.array[wp.int32]
    """Steps in which a world was held still because its state was not finite."""
    sweeps: wp.array[wp.int32]
    """Sweeps of the last step."""
    settled: wp.array[float]
    """Update at which sweeps of the last step ended by themselves [m]."""
    update: wp.array[float]
    """How far the last sweep of the last step still moved a body [m], a turn by its radius of
    gyration."""
    step: wp.array[float]
    """Second order: the step that inertia sees [s]."""
    overflow: wp.array[wp.int32]
    """Most contacts by which a step's buffer overflowed, shape (1,)."""
    dropped: wp.array[wp.int32]
    """Contacts that made no sense, of all steps, shape (1,)."""
    bounded: wp.array[wp.int32]
    """How often the energy of an island was bounded, of all steps."""
    excess: wp.array[float]
    """Energy that this took [J], of all steps."""
    unbounded: wp.array[wp.int32]
    """How often an island had too much, but linked to what the user moves, of all steps."""
    repaired: wp.array[wp.int32]
    """Poses whose quaternion was not of unit length, of all steps."""
    island: wp.array[wp.int32]
    """Sleeping: by body slot, first body of the island that it sleeps with; -1 for a body that is
    awake, less for one that the solver does not move."""
    island_start: wp.array[wp.int32]
    """Sleeping: first of each world's islands, shape (world_count + 1,)."""
    threads: int
    """Sleeping: how many threads share the islands."""
    pace: wp.array[float]
    """Sleeping: how far a kinematic body of the world goes in the step [m]."""
    inner: InnerWork


@wp.struct
class IslandSum:
    """What is summed over the bodies of an island."""

    bodies: int
    mass: float
    """Mass [kg]."""
    com: wp.vec3
    """Mass times COM [kg m], in the end the COM [m]."""
    moved: wp.vec3
    """Mass times how far its inertial targets move the COM [kg m], in the end that itself [m]."""
    momentum: wp.vec3
    """Missing momentum times h [kg m], in the end the shift that makes up for it [m]."""
    angular: wp.vec3
    """Missing angular momentum about the island's COM, of increments times h [kg m^2 or N m s]; in
    the end the turn or angular velocity that makes up for it [rad or rad/s]."""
    inertia: wp.mat33
    """Inertia about the island's COM [kg m^2]."""


@wp.struct
class Balance:
    """What is summed over an island whose sweeps did not settle, to bound its energy."""

    before: float
    """Kinetic energy before the step, and work done in it [J]."""
    after: float
    """Kinetic energy after it [J]."""
    mass: float
    """Mass [kg]."""
    com: wp.vec3
    """Mass times COM [kg m], from where the COM of the root was."""
    start_com: wp.vec3
    """The same before the step."""
    momentum: wp.vec3
    """Momentum after the step [N s], in the end the velocity of the COM [m/s]."""
    angular: wp.vec3
    """Angular momentum about the COM after the step [N m s], in the end the angular velocity, or
    that by which the island turns as a rigid body [rad/s]."""
    free_momentum: wp.vec3
    """Momentum after the step if nothing fixed pushes [N s], in the end the velocity of the COM
    that is to be [m/s]."""
    free_angular: wp.vec3
    """Likewise angular momentum, about where the COM of the root was [N m s], in the end the
    angular velocity [rad/s]."""
    inertia: wp.mat33
    """Inertia about the COM [kg m^2]."""
    start: float
    """Energy that it would have without what acts between its bodies [J]: kinetic energy before the
    step, and the work of external forces at the velocities then."""
    given: float
    """What springs, tendons, rotors and compliant contacts have given in the step at most [J]."""
    pushed: float
    """Work of contacts with what the solver does not move [J]."""
    push: wp.vec3
    """Sum of their forces [N]."""
    load: float
    """Sum of the magnitudes of these [N]."""
    way: wp.vec3
    """How far their surfaces go in the step, by the magnitudes of the forces [N m]."""
    start_inertia: wp.mat33
    """Inertia about the COM before the step [kg m^2]."""
    is_anchored: wp.bool
    """Whether a joint links the island to something that the solver does not move."""
    is_touched: wp.bool
    """Whether the island pushes something that the solver does not move."""
    is_pushed: wp.bool
    """Whether something that the user moves does work on it that is not known."""
    is_wild: wp.bool
    """Whether a body is faster than anything could be."""
    is_turned: wp.bool
    """Whether a body has turned so far that what is linear in its turn says nothing."""
    is_bounded: wp.bool
    """Whether it had too much."""
    is_rigid: wp.bool
    """Whether its step is taken back, and it moves as a rigid body instead."""
    share: float
    """Share of its velocities relative to the rigid motion that it keeps."""


@wp.struct
class IslandWork:
    """Per body slot: which bodies push each other, as a forest whose roots are their first body."""

    parent: wp.array[wp.int32]
    fixed: wp.array[wp.int32]
    """At the root of an island: what that the solver does not move acts on it, FREE, TOUCHING or
    HELD of ``step/islands.py``."""
    sum: wp.array[IslandSum]
    """At the root of an island."""
    hold_ll: wp.array[wp.mat33]
    """Likewise: curvature of its contacts with fixed things about its COM, times h^2 [kg]; that of
    turns is in the inertia of the sum."""
    hold_al: wp.array[wp.mat33]
    """Likewise [kg m]."""
    balance: wp.array[Balance]
    """At the root of an island that did not settle."""
    start_q: wp.array[wp.transform]
    """Poses at the start of a step that did not settle: its end may have taken their array."""
    start_qd: wp.array[wp.spatial_vector]
    """Likewise velocities [m/s, rad/s]."""


@wp.struct
class TreeAxis:
    """One degree of freedom of a joint, eliminated from its child's block."""

    linear: wp.vec3
    """Motion of the child's COM by a unit of the coordinate, world frame [m or 1]."""
    angular: wp.vec3
    """Turn of the child by a unit of the coordinate [rad or 0]."""
    force: wp.vec3
    """Force that a unit of the coordinate meets in the articulated block [N]."""
    torque: wp.vec3
    inv_pivot: float
    """1 over the stiffness of the coordinate in the articulated block."""
    push: float
    """Generalized force on the coordinate [N or N m]."""
    pivot: float
    """The stiffness itself where a limit holds the coordinate, otherwise zero."""
    step: float
    """Step of the coordinate to the limit that holds it [m or rad]."""


@wp.struct
class Closure:
    """A joint that closes a loop within a block, one that mimics another, or a tendon."""

    loop: int
    """Index in ``LoopWork.joints``; -1 for a mimic or a tendon."""
    joint: int
    body: int
    """Mimics: the body that the joint links to its parent."""
    leader_body: int
    """Mimics: the body that the leader links to its parent."""
    place: int
    """Mimics: where the first row meets the joint's axes, a place in ``met``."""
    leader_place: int
    """Mimics: where it meets the leader's."""
    row: int
    """First of its rows."""
    rows: int
    softness: float
    """How soft its rows are, of what those are that may imply each other."""
    equality: int
    """MuJoCo's equality constraints: its row there; -1 for all others."""
    dof: int
    """The same: axis of the joint that it ties."""
    leader_dof: int
    """The same: axis of the leader, -1 where the joint is held."""
    tendon: int
    """Index of the tendon whose row it is; -1 for others."""
    other: int
    """Equality constraints of tendons: the tendon that it follows, itself where it is held; -1 for
    what acts along a tendon."""
    ends: int
    """Tendons: first in ``ends`` of where elements of its path push, then those of ``other``."""
    slot: int
    """Tendons: first of the entries in ``way`` of its row beyond the two that each row has."""
    slot_end: int


@wp.struct
class ClosureBlock:
    """The closures of one block, and where their arrays lie."""

    first: int
    """First of the closures."""
    end: int
    gram: int
    """First place in ``gram``."""
    gram_end: int
    ground: int
    """The node of the rows that end at no body."""


@wp.struct
class ClosureNode:
    """What elimination meets at a body: closures whose rows end there, rows that go on."""

    first: int
    """First of the closures that end."""
    end: int
    row: int
    """First of their rows."""
    row_end: int
    start: int
    """First of the places, in ``items`` and ``met``, of the rows that go on."""
    stop: int


@wp.struct
class ClosureWork:
    """Equations that are solved with a tree; see :mod:`.step.closures`."""

    block_of: wp.array[wp.int32]
    """By position of a block's first body in visiting order: its ``ClosureBlock``, -1 without."""
    blocks: wp.array[ClosureBlock]
    closures: wp.array[Closure]
    """In the order of their elimination, block by block."""
    nodes: wp.array[ClosureNode]
    """By body slot, then one for the rows of each block that end at no body."""
    items: wp.array[wp.int32]
    """Rows that go on from a body, in the order of elimination: 2 row, + 1 on the way up from the
    parent of a joint or on the shorter one of a mimic."""
    met: wp.array[wp.spatial_vector]
    """By place: what the row meets of each axis of the body's joint, or of a free root."""
    slots: wp.array[wp.int32]
    """By place: entry of ``way`` that the row has at the body. Of joints it is the item itself all
    the way up; a tendon, which may branch, has one at each body."""
    next: wp.array[wp.int32]
    """By place: the entry that it adds to at the parent."""
    ends: wp.array[wp.int32]
    """By element of a tendon's path and row: entry of ``way`` at its body, -1 where that does not
    move; of a fixed tendon the place of the joint."""
    way: wp.array[wp.spatial_vector]
    """By entry: wrench by which the row pushes the body that it has come to [1, m]."""
    misfit: wp.array[float]
    """By row: how far a mimic is off at the start of the step [m or rad]."""
    direction: wp.array[wp.vec3]
    """By row: what a joint locks, a unit vector in world frame."""
    whole: wp.array[float]
    """By row: how far it is moved by its own multiplier alone [m/N or rad/(N m)]."""
    stopped: wp.array[float]
    """By row: how much farther without stops and friction that hold axes on its way."""
    least: wp.array[float]
    """By row: how far the multiplier would move bodies that nothing else holds; 0 for a mimic."""
    gives: wp.array[float]
    """By row: how far it gives way to its multiplier [m/N or rad/(N m)]; 0 for what is rigid."""
    held: wp.array[float]
    """By row: what it has pushed with, which its softness keeps to [N or N m]; 0 for a mimic."""
    most: wp.array[float]
    """By row: most that it may push with if others imply it [N or N m]; 0 for what may push with
    any force."""
    loosened: wp.array[float]
    """By row: how much softer it may become for that [m/N or rad/(N m)]."""
    multiplier: wp.array[wp.float64]
    """By row: J delta_0 + r [m or rad], then mu [N or N m]."""
    gram_row: wp.array[wp.int32]
    """Where the first column of a row of ``gram`` would lie."""
    gram: wp.array[wp.float64]
    """How far a row is moved by the multipliers of those that are eliminated after it, up to the
    last that it meets; on the diagonal, after elimination, the inverse of the pivot."""


@wp.struct
class AxisLaw:
    """What acts along an axis of a tree and is not linear in its coordinate: stops, friction, a
    drive with an effort limit. Steps are counted from where the coordinate is."""

    lower: float
    """Step to the lower stop [m or rad]."""
    upper: float
    slack: float
    """Step beyond a stop that has let go which rounding explains [m or rad]."""
    hold: float
    """Step to where friction holds [m or rad]."""
    friction: float
    """Most that friction pushes with [N or N m]."""
    held: float
    """What friction that holds pushes with, as the last sweep found it [N or N m]."""
    drive: float
    """Generalized force of the drive before its limit [N or N m]."""
    drive_stiffness: float
    least: float
    """Least and most that the drive pushes with [N or N m]."""
    most: float
    piece: wp.vec3i
    """The piece of the law that elimination assumed; see :func:`.step.axes.make_axis`."""
    next: wp.vec3i
    """The piece that substitution found that it should be."""


@wp.struct
class CableGuide:
    """A guide of one of Newton's tendons, a cable here, and the body that it is on."""

    kind: int
    """A ``newton.TendonGuideType``."""
    slot: int
    """Slot of the body; the static world's for a guide that is fixed in space."""
    arm: wp.vec3
    """From the COM of the body to the guide [m], body frame; in the static world its place."""
    turn: wp.quat
    """From the frame of the link that the guide is on to that of its body."""
    offset: wp.vec3
    """Place of the guide in the frame of its link [m]."""
    axis: wp.vec3
    """Axis of a roller in the frame of its link."""
    radius: float
    """Of a roller [m]."""
    side: float
    """Side on which the cable winds, 1 or -1."""
    is_dynamic: wp.bool
    """Whether the cable touches the roller only where its way leads there."""
    detour: float
    """Dynamic guides: length between the neighbors without it, in the initial poses [m]."""


@wp.struct
class CableWork:
    """Newton's tendons: cables of segments between guides; see :mod:`.step.cables`.

    Segment ``guide - cable`` goes from a guide to the next one of its cable. Cables whose bodies
    one block holds, or that share a block with such cables, make a *cluster*, which is solved at
    once.
    """

    world_start: wp.array[wp.int32]
    """First cluster of each world."""
    world: wp.array[wp.int32]
    """World of each cluster."""
    cluster_start: wp.array[wp.int32]
    """First of a cluster's cables in ``cables``."""
    cables: wp.array[wp.int32]
    """The cables, cluster by cluster."""
    row: wp.array[wp.int32]
    """By segment: its row among those of its cluster."""
    size: wp.array[wp.int32]
    """By cluster: how many rows it has."""
    first_row: wp.array[wp.int32]
    """By cluster: how many rows there are before its own."""
    guide_start: wp.array[wp.int32]
    """By cable: first of its guides, and where the last one's end."""
    guides: wp.array[CableGuide]
    mu: wp.array[float]
    """By guide: friction coefficient."""
    touched: wp.array[wp.bool]
    """By guide: whether the cable touches it in the step."""
    slip: wp.array[wp.int32]
    """By guide: how the cable passes it; see :mod:`.rows.cable`."""
    ratio: wp.array[wp.float64]
    """By guide: logarithm of the largest ratio of tensions."""
    active: wp.array[wp.int32]
    """By segment: 1 where the route of the step has it."""
    left: wp.array[wp.int32]
    """Guides that it goes from and to."""
    right: wp.array[wp.int32]
    compliance: wp.array[float]
    """[m/N]"""
    damping: wp.array[float]
    """[N s/m]"""
    rest: wp.array[float]
    """Length of its material at the start of the step [m]."""
    lost: wp.array[float]
    """What rounding took from it [m]."""
    base_left: wp.array[wp.vec3]
    """Where it touched its guides at the start of the step, in the frames of their links [m]."""
    base_right: wp.array[wp.vec3]
    start: wp.array[wp.float64]
    """Length beyond ``rest`` at the start of the step [m]."""
    left_over: wp.array[float]
    """The same at the end of the last step."""
    misfit: wp.array[wp.float64]
    """What of it the sweeps leave to the recovery [m]."""
    stretch: wp.array[wp.float64]
    """Length beyond the material that no slip has changed, after the increments [m]."""
    length: wp.array[float]
    """From contact point to contact point [m]."""
    direction: wp.array[wp.vec3]
    """From left to right, a unit vector in world frame."""
    spoke_left: wp.array[wp.vec3]
    """From the centers of its guides to where it touches them [m], world frame."""
    spoke_right: wp.array[wp.vec3]
    way: wp.array[wp.spatial_vector]
    """By segment and end, left first: wrench on the body by a unit of tension [1, m]."""
    arm: wp.array[wp.vec3]
    """Likewise: from the COM of the body to the end of the segment [m]."""
    tension: wp.array[float]
    """Multiplier [N]; the next step starts from it."""
    before: wp.array[float]
    """Tension at the start of the step [N]."""
    kept: wp.array[float]
    """Tension of the motion, while the recovery pulls."""
    chain: wp.array[wp.int32]
    """The segments of a cluster whose tensions are solved for, from ``first_row`` on."""
    group: wp.array[wp.int32]
    """Segments between which the cable slips share one unknown; see :mod:`.rows.cable`."""
    slack: wp.array[wp.bool]
    weight: wp.array[wp.float64]
    load: wp.array[wp.float64]
    """By segment: what it would be beyond its target if its cable did not pull [m]."""
    pull: wp.array[wp.float64]
    """By segment: tension that is solved for [N]."""
    answer: wp.array[wp.float64]
    """By group, from ``first_row`` on: right-hand side, then solution."""
    matrix_start: wp.array[wp.int32]
    """By cluster: first place of its matrices."""
    mobility: wp.array[wp.float64]
    """How far a unit of tension of a row shortens another one [m/N], cluster by cluster."""
    matrix: wp.array[wp.float64]
    """Of its groups [m/N]."""
    wrench: wp.array[wp.spatial_vector]
    """By body slot: what cables pull it with [N, N m]."""
    pulled: wp.array[wp.bool]
    """Whether one pulls it."""
    ll: wp.array[wp.mat33]
    """Geometric stiffness of its cables: what pulls turns with the segment."""
    al: wp.array[wp.mat33]
    aa: wp.array[wp.mat33]
    push: wp.array[wp.spatial_vector]
    """Scratch of the answer of a block to a pull: wrench, then motion, by body slot."""
    update: wp.array[wp.spatial_vector]
    axis_push: wp.array[float]
    """The same by axis of the trees."""


@wp.struct
class AxisMotion:
    """How a coordinate of a joint, or its velocity, changed in the last step."""

    start: wp.float64
    """Its value at the start of the step."""
    rate: float
    """Its rate at the end."""
    slope: float
    slip: int
    """Which way friction pushed at the end, as in :attr:`AxisLaw.piece` but 2 more, and 4 more
    where a stop held; 0 before."""


@wp.struct
class Wrap:
    """Where a path touches a geom, and its length along it, which is below 0 where it does not."""

    length: wp.float64
    first: wp.vec3d
    last: wp.vec3d
    back: wp.float64
    """How far one of the spans beside it runs backwards [m]: the first, or if it is below 0 the
    last."""
    along: wp.vec3d
    """Direction of that span from its start to its end."""
    way: wp.vec2i
    """See :attr:`TendonModel.way`."""


@wp.struct
class TendonSpan:
    """A straight piece of a spatial tendon."""

    a: int
    """Element of the path whose body holds its start."""
    b: int
    """That of its end."""
    start: wp.vec3
    end: wp.vec3
    along: wp.vec3
    """Direction from start to end; zero where they coincide."""
    length: float
    """How far either end is from what the span turns about as that end moves [m]."""
    share: float
    """1 over the divisor of the pulley before it."""


@wp.struct
class TendonModel:
    """MuJoCo's tendons that act, their paths, and what acts along them; see :mod:`.rows.tendon`."""

    row: wp.array[wp.int32]
    """Row in the ``mujoco`` namespace of each."""
    world: wp.array[wp.int32]
    """Newton world of each."""
    start: wp.array[wp.int32]
    """First of the elements of each tendon's path."""
    kind: wp.array[wp.int32]
    """By element: joint of a fixed tendon, site, sphere, cylinder, pulley or side site."""
    value: wp.array[float]
    """Coefficient of a joint, radius of a geom [m], or divisor of a pulley."""
    dof: wp.array[wp.int32]
    """Joints: degree of freedom."""
    coordinate: wp.array[wp.int32]
    """Joints: coordinate in the model's array."""
    axis: wp.array[wp.int32]
    """Joints: entry of :attr:`TreeWork.axes`."""
    link: wp.array[wp.int32]
    """Others: link that holds the element, -1 for the world, and where on it."""
    link_frame: wp.array[wp.transform]
    body: wp.array[wp.int32]
    """The same of the body that the link belongs to."""
    frame: wp.array[wp.transform]
    ref: wp.array[float]
    """``mujoco:dof_ref``, by degree of freedom."""
    apart: wp.array[wp.vec3]
    """Start-of-step COM of the element's body, or the place in the world, from an origin near it
    [m]."""
    begun: wp.array[wp.vec3]
    """Where elements start, from there [m]."""
    point: wp.array[wp.vec3d]
    """Where they are [m]."""
    rotation: wp.array[wp.quat]
    """Orientation of geoms."""
    outside: wp.array[wp.vec3d]
    """By geom with a side site inside, how far outside of its surface the nearer end of its path
    is [m]: at the start of the step, now, and where the step is taken to pass."""
    way: wp.array[wp.vec2i]
    """By geom, how its path goes since the start of the step (:data:`.rows.path.STRAIGHT`), and
    whether it is to jump to another way then."""
    spans: wp.array[TendonSpan]
    """Spans of a tendon from its first element on."""
    span_end: wp.array[wp.int32]
    """Where they end."""
    stiffness: wp.array[float]
    """The model's arrays, by row."""
    damping: wp.array[float]
    springlength: wp.array[wp.vec2]
    friction: wp.array[float]
    armature: wp.array[float]
    range: wp.array[wp.vec2]
    margin: wp.array[float]
    limit_impedance: wp.array[vec5]
    is_limited: wp.array[wp.bool]
    """By tendon: whether it keeps to its range."""
    limit_rates: wp.array[wp.vec2]
    """As those of :class:`JointModel`, by tendon."""
    limit_mobility: wp.array[float]
    rest: wp.array[float]
    """Length in the reference pose [m or rad]."""
    spring_rest: wp.array[float]
    """Length in the pose in which the springs of joints are at rest [m or rad]."""
    force_range: wp.array[wp.vec2]
    """What bounds the sum of its actuators [N or N m]."""
    row_start: wp.array[wp.int32]
    """First of the actuators of each."""
    rows: wp.array[wp.int32]
    push: wp.array[AxisPush]
    """What actuators push along it in the step."""
    velocity: wp.array[float]
    """Rate of its length at the start of the step, as measured [m/s or rad/s]."""
    coasting: wp.array[wp.vec2]
    """How that changes while joints keep their rates, and what of that the path makes as it is;
    zero where nothing asks for it [m/s^2]. See :mod:`.step.tendon_coasting`."""
    start_velocity: wp.array[float]
    """The rate as the scheme of the step has it, for armature."""
    limit_velocity: wp.array[float]
    """The rate to which that comes without forces, for limits that give way."""
    start_length: wp.array[wp.float64]
    """Length at the start of the step [m or rad], ahead of it in steps of second order."""
    length: wp.array[wp.float64]
    """Length after the increments."""
    law: wp.array[AxisLaw]
    pull: wp.array[wp.vec2]
    """What is linear along it in the sweep: force and curvature."""
    force: wp.array[float]
    """What acts along it [N or N m], negative where it pulls its ends together; kept."""
    piece: wp.array[wp.vec3i]
    """Piece of its law, kept between steps."""
    held_at: wp.array[wp.float64]
    """Length at which friction holds it, kept between steps."""
    motion: wp.array[AxisMotion]
    """Second order: how its length and its rate changed in the last step, kept."""
    rate: wp.array[AxisMotion]
    input: wp.array[AxisInput]
    """Second order: what actuators pulled it with in the last step, kept."""
    curvature: wp.array[float]
    """By entry of :attr:`TreeWork.axes`: curvature of its coordinate by which paths bend."""
    root_curvature: wp.array[wp.spatial_vector]
    """By body slot: the same of a root that floats, by shift and by turn."""


NO_JOINT = wp.constant(-1)
"""In the place of the joint that links a body to its parent: the body has none."""
LONE = wp.constant(-2)
"""Likewise, of a body that is solved as a tree all the same: strings hold it."""


@wp.struct
class RungeKuttaWork:
    """Steps of fourth order; see :mod:`.step.runge_kutta`."""

    is_known: wp.array[wp.int32]
    """By world: 1 where the last step was one, so that coordinates and rates are as it left
    them."""
    waits: wp.array[wp.int32]
    """By world: steps before it tries again, -1 where the next one is not to try."""
    turns: wp.array[float]
    """By world: about how far the step takes what oscillates fastest in it [rad]."""
    guess: wp.array[wp.spatial_vector]
    """By body slot: increment from which other steps start."""
    left_q: wp.array[wp.transform]
    """Pose at the end of the last one."""
    left_qd: wp.array[wp.spatial_vector]
    """Velocity at the end of it [m/s, rad/s]."""
    start_velocity: wp.array[wp.spatial_vector]
    velocity: wp.array[wp.spatial_vector]
    """In the stage [m/s, rad/s]."""
    before: wp.array[wp.spatial_vector]
    """Acceleration in the stage before [m/s^2, rad/s^2], and after the last one the velocity in it
    [m/s, rad/s]."""
    moved: wp.array[wp.spatial_vector]
    """Roots: what the stages so far add to the pose [m, rad]."""
    gain: wp.array[wp.spatial_vector]
    """And to the velocity [m/s, rad/s]."""
    place: wp.array[wp.vec3]
    """COM at the end [m]."""
    ball_start: wp.array[wp.quat]
    """Ball joints: anchor on the child against that on the parent at the start."""
    rate: wp.array[wp.float64]
    """By entry of ``tree.axes``: rate of the coordinate in the stage [m/s or rad/s]."""
    start_rate: wp.array[wp.float64]
    gained: wp.array[float]
    """How fast it changes in the stage [m/s^2 or rad/s^2]."""
    axis_moved: wp.array[wp.float64]
    """What the stages so far add to the coordinate [m or rad]."""
    axis_gain: wp.array[wp.float64]
    """And to its rate [m/s or rad/s]."""


@wp.struct
class TreeWork:
    """Per body slot: the tree that joints make of the bodies of an articulation.

    The bodies of a tree follow each other in visiting order, parents before children.
    """

    joint: wp.array[wp.int32]
    """Joint that links the body to its parent; :data:`NO_JOINT` or :data:`LONE` for a root that
    floats."""
    parent: wp.array[wp.int32]
    """Slot of the parent; the static world's for a root."""
    axis_start: wp.array[wp.int32]
    """First of the body's entries in ``axes``."""
    axes: wp.array[TreeAxis]
    coordinate: wp.array[wp.float64]
    """Coordinate of each entry of ``axes`` after the increments [m or rad]; for a ball its turn in
    the step."""
    start_coordinate: wp.array[wp.float64]
    laws: wp.array[AxisLaw]
    """Laws of the entries of ``axes``."""
    fewest: wp.array[wp.int32]
    """At the first body of a tree: fewest axes that a sweep of the step left on a wrong piece."""
    patience: wp.array[wp.int32]
    """At the first body of a tree: sweeps left in which that number may fail to fall."""
    is_minimal: wp.array[wp.bool]
    """Whether the last sweep took the body's tree all of the way to the minimum of its model."""
    start_velocity: wp.array[float]
    """Velocity of each degree of freedom of the model at the start of the step [m/s or rad/s]."""
    rotation: wp.array[wp.quat]
    """Orientation after the increment."""
    turn: wp.array[wp.vec3]
    """Turn of the increment that goes first [rad]: that of a body that turns fast; else zero."""
    turned: wp.array[wp.quat]
    """Orientation after it."""
    swing: wp.array[wp.quat]
    """Turn of the whole increment, world axes."""
    apart: wp.array[wp.vec3]
    """From the COM of the parent to that of the body at the start of the step [m]."""
    misfit: wp.array[wp.spatial_vector]
    """How far the joint is open at the start of the step, as (shift [m], turn [rad])."""
    is_left: wp.array[wp.bool]
    """Whether the body is where the last step left it."""
    rounding: wp.array[float]
    """Shift of the body that rounding explains [m]."""
    span: wp.array[wp.vec3]
    """From the COM of the parent to that of the body, joint closed [m]."""
    closing: wp.array[wp.spatial_vector]
    """Motion of the body that closes the misfit of its joint."""
    update: wp.array[wp.spatial_vector]
    """What the last substitution added to the pose of the body."""
    is_touched: wp.array[wp.bool]
    """Whether the body has contacts or joints that close loops."""
    own_ll: wp.array[wp.mat33]
    """The body's own block, inertia, drag and loops, where contacts or loops act on it."""
    own_al: wp.array[wp.mat33]
    own_aa: wp.array[wp.mat33]
    h_ll: wp.array[wp.mat33]
    """Children's share of the block; zero between sweeps."""
    h_al: wp.array[wp.mat33]
    h_aa: wp.array[wp.mat33]
    is_fast: wp.array[wp.bool]
    """Whether a body of the same tree turns fast."""
    n_ll: wp.array[wp.mat33]
    """The same of the gyroscopic part of the block, which is antisymmetric."""
    n_al: wp.array[wp.mat33]
    n_aa: wp.array[wp.mat33]
    push: wp.array[wp.spatial_vector]
    """Children's share of the reduced wrench; zero between sweeps."""
    load: wp.array[wp.spatial_vector]
    """Children's share of the wrench that holds the tree; zero between sweeps."""
    closures: ClosureWork
    cables: CableWork
    tendons: TendonModel
    runge_kutta: RungeKuttaWork


@wp.struct
class LoopWork:
    """Joints outside of trees: those that close loops, or all."""

    world_start: wp.array[wp.int32]
    joints: wp.array[wp.int32]
    """The joints, world by world."""
    is_exact: wp.array[wp.bool]
    """Whether what the joint locks is solved with the tree, and has no penalty."""
    is_soft: wp.array[wp.bool]
    """Whether the joint has rows that converge by a factor, sweep by sweep."""
    yielding: wp.array[vec5]
    """Joints that give way by MuJoCo's law: k [1/s^2], b [1/s] of ``eq_solref``, how many radians
    count as much as a meter, mobility of shifts [1/kg] and turns [1/(kg m^2)]; zeros for others."""
    impedance: wp.array[vec5]
    """The same: ``eq_solimp``."""
    gives: wp.array[wp.vec2]
    """The same: by how much a push shifts [m/N] and turns [rad/(N m)] them in the step."""
    wanted: wp.array[wp.spatial_vector]
    """The same: how far the child moves against the parent in the step without a push [m, rad]."""
    span: wp.array[float]
    """The same: length of the step [s]."""
    body_start: wp.array[wp.int32]
    items: wp.array[wp.int32]
    """By body slot: 2 i where the body is the child of ``joints[i]``, 2 i + 1 where its parent."""
    arms: wp.array[wp.vec3]
    """From the COM of the body of an item to where an exact joint pushes it [m], this sweep."""
    apart: wp.array[wp.vec3]
    """From the COM of the parent to that of the child at the start of the step [m]."""
    misfit: wp.array[wp.spatial_vector]
    """How far each joint is open at the start of the step, as (shift [m], turn [rad])."""
    recovered: wp.array[float]
    """Share of that which the recovery of the step takes out."""
    closing: wp.array[float]
    """How far that moves the anchors against each other [m]."""
    kept_force: wp.array[wp.vec3]
    """Multipliers that the softness of rows keeps to: of the start of the step, then of its first
    sweep. The recovery leaves them alone, and the joints' own return to them after it."""
    kept_torque: wp.array[wp.vec3]
    kept_stop: wp.array[float]
    """By degree of freedom of the model: what its limits pushed with before the recovery."""
    stop_side: wp.array[wp.int32]
    """By degree of freedom of the model, of joints that are solved with trees: which stop holds it
    in the sweep, -1 the lower, 1 the upper, 2 both, 0 none."""
    stop_steps: wp.array[wp.vec2]
    """The same: how far it may go down and up from where the sweep began [m or rad]."""
    reach: wp.array[float]
    """How far the joint's bodies could move its anchors in the step [m]."""
    turn_reach: wp.array[float]
    """How far they could turn them [rad]."""
    side: wp.array[wp.int32]
    """DISTANCE joints that are solved with trees: which bound holds them in the sweep, 1 the upper,
    -1 the lower, 2 both, 0 none."""
    k_l: wp.array[float]
    """Penalty of shifts [N/m]; zero for a joint that does nothing."""
    k_a: wp.array[float]
    """Penalty of turns [N m/rad]."""
    start_coordinate: wp.array[wp.float64]
    """Coordinate at the start of the step, by degree of freedom of the model [m or rad]."""
    coordinate: wp.array[wp.float64]
    """Coordinate at the last dual update [m or rad]."""


@wp.struct
class PileWork:
    """Free bodies that contacts link, as a forest; by body slot unless it says otherwise."""

    parent: wp.array[wp.int32]
    """Slot of the body that a body is linked to; -1 at a root, -2 outside of piles."""
    order: wp.array[wp.int32]
    """Bodies of the piles of a world from its first place on, each after its parent."""
    end: wp.array[wp.int32]
    """Where the list of each world ends, shape (world_count,)."""
    level: wp.array[wp.int32]
    """Links from the body to the root."""
    supports: wp.array[wp.int32]
    """Bodies of a lower level that the body touches."""
    mass: wp.array[float]
    """Mass of the body and its share of that of all bodies of higher levels that touch it [kg]."""
    whole: wp.array[float]
    """Mass of the body's pile [kg], 0 for one on the ground."""
    held: wp.array[float]
    """Mass that the contacts with lower levels, or the ground, have to hold [kg]."""
    lasting: wp.array[float]
    """Share of their force that the next step can expect again: what stopped something ends."""
    ll: wp.array[wp.mat33]
    """Block of the body and of what is linked behind it, without the link to its parent; once that
    is factored, of a group that moves, the body's inertia and what leads out of the group."""
    al: wp.array[wp.mat33]
    aa: wp.array[wp.mat33]
    link_ll: wp.array[wp.mat33]
    """Curvature of the link to the parent, about the COM of the body."""
    link_al: wp.array[wp.mat33]
    link_aa: wp.array[wp.mat33]
    push: wp.array[wp.spatial_vector]
    """Wrench on the body and on what is linked behind it [N, N m]."""
    group: wp.array[wp.int32]
    """First body of the body's group (``step/groups.py``)."""
    tied: wp.array[wp.int32]
    """At the first body of a group: ALONE, TIED, PUSHED or SUMMED of ``step/groups.py``. There
    ``link_ll``, ``link_al`` and ``link_aa`` hold the group's block, ``update`` its wrench and its
    motion."""
    shared: wp.array[float]
    """Likewise: how far that motion has moved one of its bodies at most, squared [m^2]."""
    update: wp.array[wp.spatial_vector]
    """How the body moves in a sweep [m, rad]."""


@wp.struct
class RowWork:
    """Contact rows of the step; see the module docstring for the order of rows."""

    owner: wp.array[wp.int32]
    """Owner of each contact, -1 where the solver moves neither body."""
    contacts: wp.array[wp.int32]
    """Contacts sorted by owner."""
    awake: wp.array[wp.int32]
    """Sleeping: contacts of bodies that are awake."""
    awake_count: wp.array[wp.int32]
    """Sleeping: how many there are, shape (1,)."""
    rows: wp.array[ContactRow]
    drift: wp.array[wp.vec3]
    """How far moving surfaces carry b against a in the step, and how far a bounce is to take b away
    from a, with the opposite sign [m]."""
    left: wp.array[float]
    """Scenes with joints: what the sweeps of the recovery before have left of the gap [m]."""
    spin: wp.array[SpinRow]
    """Torsional and rolling friction."""
    impacts: wp.array[Impact]
    """Restitution."""
    mixed: wp.array[MixedRow]
    """Where links may push what moves."""
    struck_qd: wp.array[wp.spatial_vector]
    """Restitution: velocity of each body slot while impacts go through the world."""
    struck_at: wp.array[float]
    """Restitution: when in the step the body was struck last [s]; negative before."""
    share: wp.array[float]
    """Compliant contacts: K/(K + k), the share of the multiplier that a compliant row keeps."""
    stiffness: wp.array[float]
    """Ramped formulation: where the penalty ends, the material's stiffness [N/m]."""
    damping: wp.array[float]
    """Ramped formulation: the material's damping [N s/m]."""
    owned_start: wp.array[wp.int32]
    owned_end: wp.array[wp.int32]
    other_start: wp.array[wp.int32]
    other_end: wp.array[wp.int32]
    other_rows: wp.array[wp.int32]
    sums: wp.array[wp.int32]
    """Sorting by many threads: scratch of prefix sums."""
    piles: PileWork


@wp.struct
class SleepWork:
    """Who may sleep and what is kept of who does; by body slot unless it says otherwise.

    What is awake is solved island by island: the solve sees a second ``WorldWork`` and ``History``
    in which what is by world is by island, and positions count the bodies that are awake.
    """

    tied: wp.array[wp.int32]
    """First of the bodies that joints tie to the body."""
    still: wp.array[float]
    """For how long the body has been at rest [s]; negative in the step in which it wakes."""
    woken: wp.array[wp.int32]
    """At the first body of an island that sleeps: 1 where something wakes it."""
    stirred: wp.array[wp.int32]
    """1 where an island is to wake, shape (1,)."""
    pose: wp.array[wp.transform]
    """Pose in the last step's state_in."""
    wrench: wp.array[wp.spatial_vector]
    """External force [N] and torque [N m] in the last step."""
    met: wp.array[wp.int32]
    """Sum of the marks of the body's contacts, numbers that tell pairs of shapes from others."""
    contacts: wp.array[wp.int32]
    """The same in the last step."""
    marks: wp.array[wp.int32]
    """Sum of the marks of all contacts of what sleeps, shape (1,)."""
    blocks: wp.array[wp.int32]
    """Where the blocks that are awake begin in visiting order, world by world."""
    block_start: wp.array[wp.int32]
    """First of each world's, shape (world_count + 1,)."""
    start: wp.array[wp.int32]
    """First of the records of a body that sleeps, beyond those of the rows."""
    end: wp.array[wp.int32]
    order: wp.array[wp.int32]
    """Bodies that sleep, in the order of their records."""
    filled: wp.array[wp.int32]
    """How many bodies ``order`` lists, where their records end, and 1 where some have woken."""
    islands: IslandWork
    quiet: wp.array[float]
    """At the first body of an island: the least time that its bodies have been at rest [s]."""
    size: wp.array[wp.int32]
    """At the first body of an island: number of its bodies."""
    place: wp.array[wp.int32]
    """At the first body of an island: where the next of its bodies is listed."""
    gravity: wp.array[wp.vec3]
    """Gravity of the last step [m/s^2], by Newton world."""
    pull: wp.array[float]
    """By tendon: what actuators pull it with."""
    joint_f: wp.array[float]
    """The last step's control."""
    target_q: wp.array[float]
    target_qd: wp.array[float]
    loop_body: wp.array[wp.int32]
    """By world: a body of the island that has all joints outside of trees, -1 without."""
    loop_start: wp.array[wp.int32]
    """The model's ``LoopWork.world_start`` and ``ClosureWork.block_of``, and what of them the
    solve sees."""
    seen_loop_start: wp.array[wp.int32]
    block_of: wp.array[wp.int32]
    seen_block_of: wp.array[wp.int32]


@wp.struct
class LastStep:
    """How a body moved in the last step, for one of second order: rates at its end, and slopes."""

    slope: wp.spatial_vectorf
    """Of the pose [m/s, rad/s], without the recovery."""
    velocity: wp.spatial_vectorf
    """Velocity at the end of the step [m/s, rad/s]."""
    lost: wp.spatial_vectorf
    """Carried rounding: what rounding took from that velocity [m/s, rad/s]."""
    acceleration: wp.spatial_vectorf
    """Without what external forces gave [m/s^2, rad/s^2]."""
    gain: wp.spatial_vectorf
    """Slope of the velocity, likewise [m/s^2, rad/s^2]."""
    torque: wp.vec3
    """Rate of the angular momentum about the COM, likewise [N m]; where moments differ."""
    spun: wp.vec3
    """Its slope [N m]."""
    wrench: wp.spatial_vectorf
    """External force [N], weight included, and torque [N m]."""
    inertia: wp.vec2
    """Mass of the body [kg], and a sum of its moments [kg m^2]."""
    pose: wp.transform


@wp.struct
class Flight:
    """Where the last step left a body that nothing held, and what rounding took from that."""

    pose: wp.transform
    velocity: wp.spatial_vectorf
    """[m/s, rad/s]"""
    lost: wp.spatial_vectorf
    """From the velocity [m/s, rad/s]."""
    lost_shift: wp.vec3
    """From the position [m]."""
    lost_turn: wp.quat
    """From the quaternion."""


@wp.struct
class History:
    """Kept between steps; arrays of two sides have shape (2, ...)."""

    parity: wp.array[wp.int32]
    """Side that the next step reads, shape (world_count,); the same for all worlds."""
    start: wp.array2d[wp.int32]
    """First record owned by a body."""
    end: wp.array2d[wp.int32]
    records: wp.array2d[ContactRecord]
    torque: wp.array2d[wp.vec3]
    """Torque of each record [N m], world frame: torsional and rolling friction."""
    row_of_contact: wp.array2d[wp.int32]
    """Record of each row of the contact buffer, -1 without; used with contact matching."""
    filling: wp.array2d[wp.int32]
    """Buffer and generation that a world's records came from, shape (world_count, 2)."""
    joint_force: wp.array[wp.vec3]
    """Force of the tree's joint on the body at the end of the last step [N], world frame."""
    left_q: wp.array[wp.transform]
    """Pose that the last step gave a body with joints."""
    lost: wp.array[wp.vec3]
    """What rounding took from that position [m]."""
    lost_turn: wp.array[wp.quat]
    """Carried rounding: what rounding took from its quaternion."""
    loop_force: wp.array[wp.vec3]
    """Multipliers of the joints outside of trees: force on the child [N], world frame."""
    loop_torque: wp.array[wp.vec3]
    loop_rate: wp.array[wp.spatial_vector]
    """How fast a joint that gives way changed in the last step [m/s, rad/s], world frame."""
    joint_angle: wp.array[wp.float64]
    """Angle of each degree of freedom with its turns counted [rad], shape (joint_dof_count,)."""
    broken: wp.array[wp.bool]
    """Joints that broke since the last reset; empty where none can."""
    piece: wp.array[wp.vec3i]
    """Piece of its law that each degree of freedom of a tree is on."""
    joined_qd: wp.array2d[wp.spatial_vector]
    """Velocities that the last step gave the child and the parent of a joint, where joints have
    armature [m/s and rad/s]."""
    axis_velocity: wp.array[float]
    """Velocity of a degree of freedom with armature in the last step [m/s or rad/s]."""
    held_at: wp.array[wp.float64]
    """Coordinate at which friction holds a degree of freedom of a tree [m or rad]."""
    limit_force: wp.array[float]
    """Multiplier of the limit that holds a degree of freedom outside of trees, zero where none does
    [N or N m]; pushes up where positive."""
    acceleration: wp.array[wp.spatial_vector]
    """Acceleration of a body with joints in the last step [m/s^2, rad/s^2]."""
    friction_force: wp.array[float]
    """Multiplier of friction on a degree of freedom outside of trees [N or N m]."""
    gained: wp.array[wp.vec3]
    """Acceleration of a body in the last step [m/s^2]; 0 for a body of a pile that others hold."""
    step: wp.array[float]
    """Length of the last step [s], shape (world_count,)."""
    age: wp.array[wp.int32]
    """Steps since the world's multipliers were reset, shape (world_count,)."""
    last: wp.array[LastStep]
    """Second order: the last step of each body slot."""
    flights: wp.array[Flight]
    """Carried rounding: the last flight of each body slot, where bodies are free."""
    pushing: wp.array[wp.int32]
    """Second order: contacts that pushed in the last step, by owner."""
    flying: wp.array[wp.int32]
    """Second order: 1 where nothing holds a body in the step, by body slot."""
    smooth: wp.array[wp.int32]
    """Second order: how the last step of a world went, 0 where a velocity jumped, 1 where none did,
    2 where none of what is held changed."""
    slope_age: wp.array[float]
    """Second order: how long before the end of the last step its slopes held [s], by world."""
    coordinate: wp.array[AxisMotion]
    """Second order: each degree of freedom [m or rad]."""
    input: wp.array[AxisInput]
    """Second order: what a controller pushed each degree of freedom with."""
    rate: wp.array[AxisMotion]
    """Second order: its velocity [m/s or rad/s], with the lag."""
    change: wp.array[wp.spatial_vector]
    """Error control: mean acceleration in the last step, by body slot [m/s^2, rad/s^2]."""
    wanted: wp.array[float]
    """Error control: inner step that the world would take next [s], by world."""
    ratio: wp.array[float]
    """Error control: error of the last one, as a share of what it aimed at."""
    saved: wp.array[float]
    """Error control: allowed error that has not been used [m]."""
    next_side: wp.array[wp.int32]
    """Error control: side that the step writes; without, ``1 - parity``."""
    dahl_sigma: wp.array[wp.vec3]
    """Dahl friction: torque of each rod about its bends and its twist [N m], by joint."""
    dahl_kappa: wp.array[wp.vec3]
    """Those angles at the end of the last step [rad], infinite where there was none."""


@wp.struct
class WorldScale:
    """What holds for a whole world during one step."""

    h: float
    """Time step [s]."""
    step: float
    """The step that inertia sees [s]: h, less in a step of second order."""
    by_rate: float
    """Weight of rates at the start in what a step of second order starts ahead by [s]; 0 in
    others."""
    by_slope: float
    """Weight of the last step's slopes in it [s]."""
    blend: float
    """Weight of the new slope in the mean rate of the step; 1 for backward Euler."""
    age: float
    """By how much the last step's slopes are older than its end [s]."""
    lag: float
    """How far velocities lag behind the parabola of the positions, as a share of h: half a step
    after backward Euler, not at all after a step of second order."""
    mass: float
    """Mass of all bodies that move [kg]: no contact at rest carries more."""
    gravity: float
    """Largest gravity [m/s^2]."""
    reach: float
    """Distance that anything in the world could close in the step [m]."""
    slop: float
    """Penetration that is left alone [m]."""
    tolerance: float
    """Update that is good enough for the user [m]."""
    static_slot: int
    """Slot of the static world."""


@wp.struct
class ColorWork:
    """Large worlds: blocks of a color share no contact and no joint, and move at once.

    The blocks of color c, each by its first body, are ``order[start[c * lanes] : start[(c + 1) *
    lanes]]``; the last color holds those that found none, which move one after the other. A *lane*
    is a part of a world whose bodies one thread counts or sums over.
    """

    lane_start: wp.array[wp.int32]
    """First body of each lane, as a place in ``WorldWork.bodies``, shape (lanes + 1,)."""
    world_lane: wp.array[wp.int32]
    """First lane of each world, shape (world_count + 1,)."""
    block: wp.array[wp.int32]
    """By body slot: first body of its block."""
    is_jointed: wp.array[wp.int32]
    """By body slot: 1 for the first body of a block that joints hold, touched or not."""
    priority: wp.array[wp.int32]
    """By body slot: of two blocks with the same color, that of higher priority keeps it."""
    count: wp.array[wp.int32]
    """By body slot: contacts of the body, then contacts that it owns, then the highest priority of
    what strikes it, then bodies of its island, then for the first body of a run (see
    :mod:`.drivers.colored_energy`) the place after it."""
    incident_start: wp.array[wp.int32]
    """By body slot: first of the body's contacts in ``incident``."""
    incident: wp.array[wp.int32]
    """Contacts of each body, in the order of the contact buffer."""
    partner: wp.array[wp.int32]
    """The other body of each, -1 where that does not move."""
    color: wp.array2d[wp.int32]
    """Color of the block of each body slot that is a first one, before and after a pass."""
    table: wp.array[wp.int32]
    """Blocks of a color in a lane, color by color."""
    start: wp.array[wp.int32]
    """Where these begin in ``order``."""
    order: wp.array[wp.int32]
    """First bodies of the blocks that something touches or holds, color by color."""
    sums: wp.array[wp.int32]
    """Scratch of prefix sums."""
    lane_scale: wp.array[WorldScale]
    """What each lane adds to the scale of its world."""
    lane_finite: wp.array[wp.int32]
    """1 for each lane whose bodies are finite."""
    scale: wp.array[WorldScale]
    """By world."""
    is_finite: wp.array[wp.int32]
    """1 for each world as long as its bodies are finite."""
    moved: wp.array2d[float]
    """Square of how far a sweep moved a body of each world [m^2], shape (sweeps + 1, world_count);
    first an infinity, then sweep by sweep, negative where there was none."""
    most: wp.array[wp.int32]
    """Most sweeps of each world."""
    recovered: wp.array2d[float]
    """As ``moved``, for the recovery."""
    passes: wp.array[wp.int32]
    """Most sweeps of the recovery of each world."""
    deepest: wp.array[float]
    """Deepest penetration of each world at the start of the step [m]."""
    closing: wp.array[float]
    """The farthest of :attr:`LoopWork.closing` in each world [m]."""
    is_open: wp.array[wp.int32]
    """1 for each world with a joint that is open at the start of the step."""
    has_impacts: wp.array[wp.int32]
    """1 for each world in which something bounces in the step."""
    is_held: wp.array[wp.int32]
    """Second order: 1 for each world in which a body does not fly."""
    jumps: wp.array[wp.int32]
    """Second order: 1 for each world in which a velocity is about to jump."""
    breaks: wp.array[wp.int32]
    """Second order: 1 for each world in which a body does not move on as in the last step."""
    is_moving: wp.array[wp.int32]
    """Second order: 1 for each world in which the velocity of a held body changes."""
    begin: wp.array[wp.int32]
    """Sweep with which the last round of sweeps of each world begins."""
    has_more: wp.array[wp.int32]
    """1 where a world takes further sweeps, shape (1,): in its first steps after a reset, or where
    impacts go on."""
    is_cold: wp.array[wp.int32]
    """1 where a world takes still more of them, shape (1,): in its first step after a reset."""
    is_excessive: wp.array[wp.int32]
    """1 where a world did not settle, whose energy may have to be bounded, shape (1,)."""
    lane_move: wp.array[float]
    """Square of the farthest move of each lane's bodies [m^2], negative where a gimbal leads."""
    is_unbalanced: wp.array[wp.int32]
    """1 for each world whose energy has to be looked at."""
    is_apart: wp.array[wp.int32]
    """1 where a world has joints to close, which takes more than one sweep, shape (1,)."""


@wp.struct
class Solver:
    """What lasts from step to step: the model, and what the solver has of it.

    Lies in memory of the device as an array of one, see :mod:`.drivers.launch`. What a scene does
    without is empty.
    """

    model: BodyModel
    shapes: ShapeModel
    joints: JointModel
    links: LinkModel
    worlds: WorldWork
    work: BodyWork
    rows: RowWork
    tree: TreeWork
    loops: LoopWork
    islands: IslandWork
    history: History
    colors: ColorWork
    sleep: SleepWork


@wp.struct
class Step:
    """What a step was given, and where it is to leave its result."""

    body_q: wp.array[wp.transform]
    """Poses at the start; bodies are then put to ``BodyWork.pose``."""
    body_qd: wp.array[wp.spatial_vector]
    """Velocities at the start [m/s, rad/s]."""
    body_f: wp.array[wp.spatial_vector]
    """Wrenches on bodies [N, N m]."""
    control: ControlInput
    contacts: ContactInput
    h: float
    """Time step [s]."""
    iterations: int
    """Most sweeps."""
    tolerance: float
    """[m]"""
    body_q_out: wp.array[wp.transform]
    body_qd_out: wp.array[wp.spatial_vector]


class Context(NamedTuple):
    """Structs of which the launcher makes a :class:`Solver`; None for those without arrays."""

    model: Any
    shapes: Any
    joints: Any
    links: Any
    worlds: Any
    work: Any
    rows: Any
    tree: Any
    loops: Any
    islands: Any
    history: Any
    colors: Any
    sleep: Any


def merged(*structs: Any) -> Any:
    """A struct with the arrays of others of its kind, of the last that has them."""
    result = structs[0]._cls()
    for struct in structs:
        for name in struct._cls.vars:
            if getattr(struct, name) is not None:
                setattr(result, name, getattr(struct, name))
    return result


def allocate(struct: Any, shape: Any, *names: str) -> None:
    """Makes arrays of a struct, of the types that it declares: zeros on Warp's current device."""
    for name in names:
        setattr(struct, name, wp.zeros(shape, dtype=struct._cls.vars[name].type.dtype))


def fill(struct: Any, **values: Any) -> None:
    """The same with values."""
    for name, array in values.items():
        setattr(struct, name, wp.array(array, dtype=struct._cls.vars[name].type.dtype))

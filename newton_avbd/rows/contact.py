# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Contact rows: non-penetration and Coulomb friction by multipliers and a constant penalty.

A row measures the slip u of body b against body a over the step at one point,

    u = (dx_b + dtheta_b x r_b) - (dx_a + dtheta_a x r_a),

and pushes b with the force (a with its opposite)

    F = proj( lambda - k_n (n.u + gap) n - k_t (u - (n.u) n) ),

where proj maps to the circular Coulomb cone |F_t| <= mu F_n, F_n >= 0. The dual update is
lambda <- F. Penalties are constant during a step, so the curvature k J^T J of all rows, active or
not, majorises the objective and the block of a free body is factored once a step. Blocks of trees
are made anew in each sweep, with the curvature of what pushes (:func:`stiffness`).
"""

import warp as wp

from ..algebra.so3 import exp_quat, turned_from
from ..data import ContactRow, WorldScale

PENALTY = wp.constant(10.0)
"""Normal penalty in units of effective mass / h^2."""
JAMMED = wp.constant(1.0e4)
"""Force that a contact keeps at most, by what moves all of a world by the size of its body
in a step."""
LOAD_WEIGHT = wp.constant(0.1)
"""Weight of the carried mass (multiplier over gravity) against the effective mass."""
TANGENT_RATIO = wp.constant(0.3)
"""Tangential penalty over normal penalty."""
RELEASE_RATIO = wp.constant(0.15)
"""What a row near release (or at the cone, tangentially) keeps of its penalty: the majoriser would
hold back a body that is about to leave or slide."""
LINK_RELEASE_RATIO = wp.constant(0.1)
"""Likewise of the penalty that a link of a pile has for what is behind it."""
STRUCK = wp.constant(0.5)
"""Closing to expect that is an impact, as a share of g h^2."""
CREEP = wp.constant(0.1)
"""Share of the tangential penalty that what slides keeps along its slip, where blocks follow their
rows: if it turns round, friction holds it with all of it."""
SLIDING = wp.constant(0.98)
"""Share of the most that friction pushes with from which a row slides."""
RECOVERY = wp.constant(0.5)
"""Share of the penetration beyond the slop that a step removes."""


@wp.func
def geometric_average(a: float, b: float) -> float:
    """sqrt(a b): no friction where one of the shapes has none."""
    return wp.sqrt(a * b)


@wp.func
def average(a: float, b: float) -> float:
    """(a + b)/2."""
    return 0.5 * (a + b)


@wp.func
def multiply(a: float, b: float) -> float:
    """a b."""
    return a * b


@wp.func
def smaller(a: float, b: float) -> float:
    """The smaller of the two."""
    return wp.min(a, b)


@wp.func
def larger(a: float, b: float) -> float:
    """The larger of the two."""
    return wp.max(a, b)


FRICTION_MIXES = {
    "geometric_average": geometric_average,
    "average": average,
    "multiply": multiply,
    "min": smaller,
    "max": larger,
}
"""How the friction coefficients of two shapes become the contact's, by Newton's names."""


@wp.func
def relative_motion(increment_a: wp.spatial_vector, increment_b: wp.spatial_vector, span: wp.vec3):
    """Motion of b against a as the shift at the COM of a [m] and the turn [rad].

    All contacts of a pair of bodies share it: u = shift + turn x r_a. The span leads from the COM
    of b to that of a [m], so that r_b = r_a + span.
    """
    turn_b = wp.spatial_bottom(increment_b)
    shift = wp.spatial_top(increment_b) - wp.spatial_top(increment_a) + wp.cross(turn_b, span)
    return shift, turn_b - wp.spatial_bottom(increment_a)


@wp.func
def slip(
    row: ContactRow, increment_a: wp.spatial_vector, increment_b: wp.spatial_vector, span: wp.vec3
) -> wp.vec3:
    """Displacement u of b against a at the contact point over the step [m]."""
    shift, turn = relative_motion(increment_a, increment_b, span)
    return shift + wp.cross(turn, row.arm)


@wp.func
def bent_way(increment_a: wp.spatial_vector, increment_b: wp.spatial_vector) -> wp.vec3:
    """Twice what :func:`slip` counts as slip where two bodies turn as one [m].

    Its arms are those of the start of the step: b would have to go along the tangent of its circle
    about a. None of where they turn against each other, or one does not turn.
    """
    turn_a = wp.spatial_bottom(increment_a)
    turn_b = wp.spatial_bottom(increment_b)
    a2 = wp.dot(turn_a, turn_a)
    b2 = wp.dot(turn_b, turn_b)
    both = wp.dot(turn_a, turn_b)
    if both <= 0.0:
        return wp.vec3(0.0)
    turn = wp.where(a2 > b2, (both / a2) * turn_a, (both / b2) * turn_b)
    return wp.cross(turn, wp.spatial_top(increment_a) - wp.spatial_top(increment_b))


@wp.func
def carried_along(put: wp.spatial_vector, arm: wp.vec3) -> wp.vec3:
    """How far a body that was put elsewhere has moved what was at the contact point [m].

    Args:
        put: Shift of its COM [m] and its turn [rad].
        arm: From its COM, as it is now, to the contact point [m].
    """
    shift = wp.spatial_top(put)
    return shift - turned_from(exp_quat(-wp.spatial_bottom(put)), arm + shift)


@wp.func
def force(row: ContactRow, u: wp.vec3, gap: float) -> wp.vec3:
    """Force on body b [N] at the slip u [m], projected to the friction cone."""
    trial = row.force - row.k_t * u
    trial_n = wp.dot(row.normal, trial)
    f_n = trial_n - (row.k_n - row.k_t) * wp.dot(row.normal, u) - row.k_n * gap
    if f_n <= 0.0:
        return wp.vec3(0.0)
    f_t = trial - row.normal * trial_n
    limit = row.mu * f_n
    f_t2 = wp.dot(f_t, f_t)
    if f_t2 > limit * limit:
        f_t = f_t * (limit / wp.sqrt(f_t2))
    return f_t + row.normal * f_n


@wp.func
def normal_force(row: ContactRow, u: wp.vec3, gap: float) -> wp.vec3:
    """Force on body b [N] at the slip u [m], without friction."""
    f_n = wp.dot(row.normal, row.force) - row.k_n * (wp.dot(row.normal, u) + gap)
    return row.normal * wp.max(f_n, 0.0)


@wp.func
def stiffness(row: ContactRow, u: wp.vec3, gap: float) -> wp.mat33:
    """How the force on body b falls as the slip u [m] grows [N/m]; zero where the row is open.

    Symmetric: that friction follows the normal force is left to the next sweep.
    """
    n = row.normal
    trial = row.force - row.k_t * u
    trial_n = wp.dot(n, trial)
    f_n = trial_n - (row.k_n - row.k_t) * wp.dot(n, u) - row.k_n * gap
    if f_n <= 0.0:
        return wp.mat33(0.0)
    f_t = trial - n * trial_n
    limit = row.mu * f_n
    f_t2 = wp.dot(f_t, f_t)
    if f_t2 <= limit * limit:
        return whole_stiffness(row)
    # across the slip friction turns with it
    k_t = row.k_t * limit / wp.sqrt(f_t2)
    along = (CREEP * row.k_t - k_t) / f_t2
    k = wp.diag(wp.vec3(k_t)) + wp.outer((row.k_n - k_t) * n, n)
    return k + wp.outer(along * f_t, f_t)


@wp.func
def whole_stiffness(row: ContactRow) -> wp.mat33:
    """What :func:`stiffness` is at most [N/m]: that of a row that sticks."""
    return wp.diag(wp.vec3(row.k_t)) + wp.outer((row.k_n - row.k_t) * row.normal, row.normal)


@wp.func
def normal_stiffness(row: ContactRow, u: wp.vec3, gap: float) -> wp.mat33:
    """As :func:`stiffness`, without friction."""
    if wp.dot(row.normal, row.force) <= row.k_n * (wp.dot(row.normal, u) + gap):
        return wp.mat33(0.0)
    return wp.outer(row.k_n * row.normal, row.normal)


@wp.func
def rigid_gap(gap: float, recovery: float, slop: float) -> float:
    """Gap that a sweep closes [m]: new error, and a share of the penetration beyond the slop."""
    return wp.max(gap, 0.0) + recovery * wp.min(gap + slop, 0.0)


@wp.func
def whole_gap(gap: float, _recovery: float, _slop: float) -> float:
    """Gap that a sweep closes [m] where contacts are compliant: overlap is what pushes."""
    return gap


@wp.func
def effective_mass(
    direction: wp.vec3,
    arm_a: wp.vec3,
    arm_b: wp.vec3,
    inv_mass: float,
    inv_inertia_a: wp.mat33,
    inv_inertia_b: wp.mat33,
) -> float:
    """Mass that a force in a direction meets at the contact point [kg]: 1 / (J M^-1 J^T)."""
    ja = wp.cross(arm_a, direction)
    jb = wp.cross(arm_b, direction)
    return 1.0 / (inv_mass + wp.dot(ja, inv_inertia_a * ja) + wp.dot(jb, inv_inertia_b * jb))


@wp.func
def carried_mass(row: ContactRow, scale: WorldScale) -> float:
    """Mass that the warm multiplier says the contact carries [kg], at most the world's.

    Without gravity what presses has to be told from what moves: by what stops the farthest motion
    of the step within it.
    """
    load = wp.dot(row.normal, row.force)
    if load <= 0.0:
        return 0.0
    pull = scale.gravity
    if pull <= 0.0:
        pull = scale.reach / (scale.h * scale.h)
    if load >= pull * scale.mass:
        return scale.mass
    return load / pull


@wp.func
def tangent_penalty(row: ContactRow, k: float) -> float:
    """Penalty across the normal [N/m]: none without friction."""
    return wp.where(row.mu > 0.0, TANGENT_RATIO * k, 0.0)


@wp.func
def is_pushing(row: ContactRow) -> bool:
    """Whether the multiplier of a row pushes."""
    return wp.dot(row.normal, row.force) > 0.0


@wp.func
def slid(row: ContactRow) -> bool:
    """Whether friction was at its cone at the end of the last step."""
    f_n = wp.dot(row.normal, row.force)
    most = SLIDING * row.mu * f_n
    return f_n > 0.0 and wp.length_sq(row.force - f_n * row.normal) >= most * most


@wp.func
def sliding_mass(
    row: ContactRow,
    span: wp.vec3,
    inv_mass: float,
    inv_inertia_a: wp.mat33,
    inv_inertia_b: wp.mat33,
) -> float:
    """Mass that friction meets where it was at its cone in the last step [kg]; else zero."""
    if not slid(row):
        return 0.0
    across = wp.normalize(row.force - wp.dot(row.normal, row.force) * row.normal)
    return effective_mass(across, row.arm, row.arm + span, inv_mass, inv_inertia_a, inv_inertia_b)


@wp.func
def loosened(
    row: ContactRow, k_t: float, mass: float, sliding: float, u: wp.vec3, f_n: float, h: float
) -> float:
    """Tangential penalty [N/m] of a row, which has ``k_t`` where it sticks, by the slip u [m] that
    its bodies would have without constraints.

    What slid slides on where friction cannot stop its mass ``sliding`` [kg] in the step: friction
    mu f_n at the slip that it leaves then has the curvature mu f_n / |u| across it, and none along
    it. What stuck is about to slide where the slip, and the normal force f_n [N] that goes with it,
    take it beyond its cone.
    """
    n = row.normal
    if sliding > 0.0:
        most = row.mu * expected_force(row, mass, u, h)
        left = wp.length(u - n * wp.dot(n, u)) - h * h * most / sliding
        if left <= 0.0:
            return k_t
        return wp.min(RELEASE_RATIO * k_t, most / left)
    trial = row.force - k_t * u
    if wp.length(trial - n * wp.dot(n, trial)) <= row.mu * f_n:
        return k_t
    return RELEASE_RATIO * k_t


@wp.func
def ends_sliding(row: ContactRow, u: wp.vec3) -> bool:
    """Whether a row that slid in the last step pushes otherwise in this one: where the slip u [m]
    that the motion has goes the way that friction pushes, or is less than what friction stops."""
    if not slid(row):
        return False
    n = row.normal
    f_n = wp.dot(n, row.force)
    u_t = u - wp.dot(n, u) * n
    if wp.dot(row.force, u_t) >= 0.0:
        return True
    return row.k_n * wp.length(u_t) < PENALTY * row.mu * f_n


@wp.func
def penalise(
    row: ContactRow,
    mass: float,
    load: float,
    held: float,
    sliding: float,
    u: wp.vec3,
    scale: WorldScale,
    is_followed: bool,
):
    """The row with its penalties for this step.

    The row is classified once a step, by the motion that the bodies would have without it: the
    curvature of rows that are about to open, or to slide, would only hold the bodies back. Not
    where blocks follow the row (``is_followed``): they have its curvature only while it pushes.

    Args:
        row: The row, with its multiplier warm-started.
        mass: Effective mass [kg].
        load: Mass that the row carried in the last step [kg].
        held: Mass that the row has to hold at once [kg], as the link of a pile.
        sliding: :func:`sliding_mass` [kg].
        u: Slip that the bodies would have without constraints [m].
        scale: The world's scale.
    """
    out = row
    unit = PENALTY / (scale.h * scale.h)
    least = unit * wp.max(mass, LOAD_WEIGHT * load)
    k = wp.max(least, unit * held)
    lambda_n = wp.dot(row.normal, row.force)
    opening = wp.dot(row.normal, u) + wp.max(row.gap, 0.0)
    f_n = lambda_n - k * opening
    if f_n <= 0.0:
        out.force = wp.vec3(0.0)
        if not is_followed:
            k = wp.max(RELEASE_RATIO * least, LINK_RELEASE_RATIO * k)
    out.k_n = k
    out.k_t = tangent_penalty(row, k)
    if f_n > 0.0 and not is_followed:
        out.k_t = loosened(row, out.k_t, mass, sliding, u, f_n, scale.h)
    return out


@wp.func
def may_push(row: ContactRow, u: wp.vec3) -> bool:
    """Whether the row pushed in the last step, or closes at the slip u [m]."""
    if wp.dot(row.normal, row.force) > 0.0:
        return True
    return wp.dot(row.normal, u) + wp.max(row.gap, 0.0) <= 0.0


@wp.func
def expected_force(row: ContactRow, mass: float, u: wp.vec3, h: float) -> float:
    """Normal force [N] to expect: that of the last step, or what would stop the slip u [m]."""
    closed = -(wp.dot(row.normal, u) + wp.max(row.gap, 0.0))
    return wp.max(wp.dot(row.normal, row.force), mass * wp.max(closed, 0.0) / (h * h))


@wp.func
def keep_share(row: ContactRow, push: wp.vec3, share: float) -> wp.vec3:
    """What a compliant row keeps of the force ``push`` [N] as its multiplier."""
    return push - ((1.0 - share) * wp.dot(row.normal, push)) * row.normal


@wp.func
def comply(
    row: ContactRow,
    mass: float,
    load: float,
    sliding: float,
    u: wp.vec3,
    stiffness: float,
    damping: float,
    scale: WorldScale,
):
    """As :func:`penalise` for a row that gives way as its material says; also returns its share.

    The material K in series with the penalty k makes k_eff = K k/(K + k), and the row keeps the
    share s = K/(K + k) of its multiplier: F = s lambda - k_eff C settles at F = -K C for any k.
    Damping acts implicitly while the bodies overlap: F = -K C - kd dC/h.

    Args:
        row: The row, with its multiplier warm-started.
        mass: Effective mass [kg].
        load: Mass that the row carried in the last step [kg].
        sliding: :func:`sliding_mass` [kg].
        u: Slip that the bodies would have without constraints [m].
        stiffness: Material stiffness K [N/m].
        damping: Material damping kd [N s/m].
        scale: The world's scale.
    """
    out = row
    k = PENALTY * wp.max(mass, LOAD_WEIGHT * load) / (scale.h * scale.h)
    u_n = wp.dot(row.normal, u)
    if row.gap + wp.min(u_n, 0.0) > 0.0:
        out.force = wp.vec3(0.0)
        k = RELEASE_RATIO * k
    total = stiffness + damping / scale.h
    if total <= 0.0:
        out.k_n = 0.0
        return out, 0.0
    if row.gap < 0.0:
        # -K (gap + u_n) - kd/h u_n = -total (gap K/total + u_n)
        out.gap = row.gap * stiffness / total
    share = total / (total + k)
    out.k_n = share * k
    out.k_t = tangent_penalty(row, k)
    f_n = wp.dot(row.normal, out.force) - k * (u_n + row.gap)
    if f_n > 0.0:
        out.k_t = loosened(row, out.k_t, mass, sliding, u, f_n, scale.h)
    out.force = keep_share(row, out.force, share)
    return out, share


@wp.func
def lasting_force(normal: wp.vec3, push: wp.vec3, mass: float, change: float, h: float) -> wp.vec3:
    """Part of a contact force [N] that the next step can expect again.

    An impact ends with the step; warm-starting its multiplier would throw the bodies apart. The
    force that changed the relative velocity along the normal is taken off.

    Args:
        normal: Unit normal from a to b.
        push: Force on body b [N].
        mass: Effective mass along the normal [kg].
        change: Slip along the normal beyond that of the velocity at the start of the step [m].
        h: Time step [s].
    """
    f_n = wp.dot(normal, push)
    spent = mass * change / (h * h)
    if spent >= f_n:
        return wp.vec3(0.0)
    return push * (1.0 - spent / f_n)


@wp.func
def kept_force(push: wp.vec3, size: float, scale: WorldScale) -> wp.vec3:
    """Contact force [N] that the next step starts from, bounded by what no scene asks for.

    Where links jam that no joint can part each sweep would add to it without end. ``size`` is that
    of the body [m].
    """
    most = JAMMED * scale.mass * size / (scale.h * scale.h)
    return push * wp.min(most / wp.max(wp.length(push), 1.0e-30), 1.0)


@wp.func
def stiffened(k: wp.mat33, arm: wp.vec3, ll: wp.mat33, al: wp.mat33, aa: wp.mat33):
    """Adds a stiffness k [N/m] at an arm [m] to a body's block, as :func:`curvature` does."""
    lever = wp.skew(arm)
    turned = lever * k
    return ll + k, al + turned, aa - turned * lever


@wp.func
def curvature(row: ContactRow, arm: wp.vec3, h_ll: wp.mat33, h_al: wp.mat33, h_aa: wp.mat33):
    """Adds the row's curvature k J^T J to a body's block; ``arm`` is the body's own.

    K = k_t I + (k_n - k_t) n n^T gives H_ll = K, H_al = [r] K, H_aa = [r] K [r]^T.
    """
    extra = row.k_n - row.k_t
    moment = wp.cross(arm, row.normal)
    scaled = extra * row.normal
    ll = h_ll + wp.outer(scaled, row.normal) + wp.diag(wp.vec3(row.k_t))
    al = h_al + wp.outer(extra * moment, row.normal) + row.k_t * wp.skew(arm)
    aa = (
        h_aa
        + wp.outer(extra * moment, moment)
        + wp.diag(wp.vec3(row.k_t * wp.dot(arm, arm)))
        - wp.outer(row.k_t * arm, arm)
    )
    return ll, al, aa

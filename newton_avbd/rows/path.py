# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""The path of a tendon of MuJoCo's.

A fixed tendon has the length L = sum_i c_i q_i of joint coordinates. A spatial one runs through
sites and around spheres and cylinders: L is the sum of its straight spans and of its arcs, each
over the divisor of the last pulley before it. An arc is a geodesic, so that its ends may slip along
it, and to first order

    dL = sum over spans of n . (dp_end - dp_start) / divisor,

with n the direction of a span and each end moving with the body of the site or geom that holds it.
Rules and names of parameters are MuJoCo's ("Modeling: Tendon", "XML Reference: tendon").

Lengths are float64: in float32 a tendon of a meter at 1 ms would pull with the rounding of its
length over h^2, 0.1 N for each kg.
"""

import warp as wp

from ..data import TendonModel, TendonSpan, Wrap

JOINT = wp.constant(0)
SITE = wp.constant(1)
SPHERE = wp.constant(2)
CYLINDER = wp.constant(3)
PULLEY = wp.constant(4)
SIDE = wp.constant(5)
"""Elements of paths: joints of a fixed tendon; of a spatial one sites, geoms to wrap around, each
followed by its side site where it has one, and pulleys."""
COINCIDENT = wp.constant(wp.float64(1.0e-12))
"""Points that are closer have no direction between them [m]."""
ZERO = wp.constant(wp.float64(0.0))
ONE = wp.constant(wp.float64(1.0))
HALF_TURN = wp.constant(wp.float64(3.141592653589793))
WHERE_IT_IS = wp.constant(0)
WITHIN = wp.constant(1)
OUTSIDE = wp.constant(2)
"""On which side of a ring a path is taken to end: where it does, with an end within, or outside."""
UNKNOWN = wp.constant(-1)
STRAIGHT = wp.constant(0)
"""How a path goes around a geom in a plane: by no arc, by the one with its left or with its right
tangent first (1 and 2), or not known."""
JUMP = wp.constant(wp.float64(0.05))
"""Share of a geom's radius by which the length of a path changes at most where it leaves the geom
or comes to it. (Arcs of less than a radian are that close to their chords.)"""
VANISHED = wp.constant(wp.float64(1.0e-30))
"""Length of a span that has vanished and whose direction counts all the same [m]."""
SHORTEST = wp.constant(1.0e-6)
"""Length of a span [m], and cosine at which a path meets a ring, that nothing is divided by less
than."""
MOST_STEPS = 20
"""Iterations for the point at which a path touches a circle from inside; 4 are usual."""


@wp.func
def crosses(a: wp.vec2d, b: wp.vec2d, c: wp.vec2d, d: wp.vec2d) -> bool:
    """Whether the line from a to b meets that from c to d."""
    u = b - a
    v = d - c
    det = u[0] * v[1] - u[1] * v[0]
    if wp.abs(det) < wp.float64(1.0e-15):
        return False
    w = c - a
    s = (w[0] * v[1] - w[1] * v[0]) / det
    t = (w[0] * u[1] - w[1] * u[0]) / det
    return s >= ZERO and s <= ONE and t >= ZERO and t <= ONE


@wp.func
def touching(p: wp.vec2d, radius: wp.float64, sign: wp.float64) -> wp.vec2d:
    """Where a line through a point outside of a circle about the origin touches it; the point of
    the circle that is next to one inside."""
    square = wp.dot(p, p)
    if square < radius * radius:
        return radius * wp.normalize(p)
    root = sign * radius * wp.sqrt(wp.max(square - radius * radius, ZERO))
    return (radius * radius * p + root * wp.vec2d(p[1], -p[0])) / square


@wp.func
def arc_by(p: wp.vec2d, q: wp.vec2d, radius: wp.float64, way: int) -> Wrap:
    """The path from p to q around a circle by the one or the other arc.

    An end inside is on the arc's end, as far as the length goes, which then changes as it does
    where the end is on the circle.
    """
    sign = wp.where(way == 1, ONE, -ONE)
    a = touching(p, radius, sign)
    b = touching(q, radius, -sign)
    out = Wrap()
    out.length = -ONE
    if not crosses(p, a, q, b):
        angle = wp.atan2(sign * (b[0] * a[1] - b[1] * a[0]), wp.dot(a, b))
        # less than none at all is rounding of two points that coincide
        whole = wp.where(angle < wp.float64(-1.0e-6), wp.float64(2.0) * HALF_TURN, ZERO)
        out.length = radius * wp.max(angle + whole, ZERO)
        out.first = wp.vec3d(a[0], a[1], ZERO)
        out.last = wp.vec3d(b[0], b[1], ZERO)
        if wp.length(p) < radius:
            out.back = VANISHED
            out.along = sign / radius * wp.vec3d(a[1], -a[0], ZERO)
        elif wp.length(q) < radius:
            out.back = -VANISHED
            out.along = sign / radius * wp.vec3d(b[1], -b[0], ZERO)
    return out


@wp.func
def way_length(p: wp.vec2d, q: wp.vec2d, arc: Wrap) -> wp.float64:
    """Length of the path from p to q, straight or by an arc."""
    if arc.length < ZERO:
        return wp.length(q - p)
    before = wp.length(wp.vec2d(arc.first[0], arc.first[1]) - p)
    return before + arc.length + wp.length(wp.vec2d(arc.last[0], arc.last[1]) - q)


@wp.func
def around_circle(
    p: wp.vec2d, q: wp.vec2d, side: wp.vec2d, has_side: bool, radius: wp.float64, known: int
) -> Wrap:
    """The path from p to q around a circle, on the given side or, without one, on the shorter.

    A path that went another way when that was ``known`` goes on by it if its length would jump.
    """
    out = Wrap()
    out.length = -ONE
    across = q - p
    square = wp.dot(across, across)
    if square < COINCIDENT * COINCIDENT or radius < COINCIDENT:
        return out
    is_outside = wp.min(wp.dot(p, p), wp.dot(q, q)) >= radius * radius
    near = p + wp.clamp(-wp.dot(across, p) / square, ZERO, ONE) * across
    way = int(STRAIGHT)
    meets = wp.dot(near, near) <= radius * radius or (has_side and wp.dot(side, near) < ZERO)
    if is_outside and meets:
        best = -wp.float64(wp.inf)
        for i in range(1, 3):
            arc = arc_by(p, q, radius, i)
            if arc.length < ZERO:
                continue
            a = wp.vec2d(arc.first[0], arc.first[1])
            b = wp.vec2d(arc.last[0], arc.last[1])
            good = -wp.length_sq(a - b)
            if has_side:
                good = wp.dot(wp.normalize(a + b), side)
            if good >= best:
                best = good
                out = arc
                way = i
    out.way = wp.vec2i(way, 0)
    if known >= STRAIGHT and known != way:
        before = Wrap()
        before.length = -ONE
        if known != STRAIGHT and wp.max(wp.length(p), wp.length(q)) >= radius:
            before = arc_by(p, q, radius, known)
        if known == STRAIGHT or before.length >= ZERO:
            if wp.abs(way_length(p, q, out) - way_length(p, q, before)) > JUMP * radius:
                out = before
                out.way = wp.vec2i(known, 1)
    return out


@wp.func
def beyond_ring(p: wp.vec2d, q: wp.vec2d, radius: wp.float64) -> Wrap:
    """The path of :func:`inside_circle` by a point of the ring, for a p within: a length without
    the kink that the path has where p passes the ring.

    The span from p to the ring has vanished there, and further in runs backwards.
    """
    out = Wrap()
    out.length = -ONE
    far = wp.length(p)
    if far < COINCIDENT:
        return out
    outwards = p / far
    touch = radius * outwards
    rest = wp.length(q - touch)
    share = wp.dot(q - touch, outwards)
    if share <= ZERO:
        # straight through the ring, with no kink
        return out
    along = (q - touch) / rest - wp.float64(2.0) * share / rest * outwards
    back = (radius - far) * share / rest
    if back >= rest:
        return out
    out.back = back
    out.length = ZERO
    out.first = wp.vec3d(touch[0], touch[1], ZERO)
    out.last = out.first
    out.along = wp.vec3d(along[0], along[1], ZERO)
    return out


@wp.func
def inside_circle(p: wp.vec2d, q: wp.vec2d, radius: wp.float64, taken: int) -> Wrap:
    """The path from p to q that a ring holds from outside: straight through it, or by the point of
    the ring at which its two spans make equal angles with the ring. An end that has passed the ring
    may be taken to be on the other side of it."""
    out = Wrap()
    out.length = -ONE
    far_p = wp.length(p)
    far_q = wp.length(q)
    if radius < COINCIDENT or taken == WITHIN:
        return out
    if wp.min(far_p, far_q) <= radius:
        if taken == OUTSIDE and wp.max(far_p, far_q) > radius:
            if far_p < far_q:
                return beyond_ring(p, q, radius)
            out = beyond_ring(q, p, radius)
            out.back = -out.back
            out.along = -out.along
        return out
    across = q - p
    square = wp.dot(across, across)
    if square > COINCIDENT * COINCIDENT:
        share = -wp.dot(across, p) / square
        if share > ZERO and share < ONE and wp.length(p + share * across) <= radius:
            return out
    # asin(A sin x) + asin(B sin x) - 2 x + G = 0, with x the angle between a span and the radius
    a = radius / far_p
    b = radius / far_q
    turn = p[0] * q[1] - p[1] * q[0]
    between = wp.atan2(wp.abs(turn), wp.dot(p, q))
    if between > HALF_TURN - wp.float64(1.0e-9):
        return out
    right = wp.float64(0.5) * HALF_TURN
    least = wp.float64(1.0e-12)
    x = right
    for _i in range(MOST_STEPS):
        s = wp.sin(x)
        f = wp.asin(a * s) + wp.asin(b * s) - wp.float64(2.0) * x + between
        slope = a / wp.sqrt(wp.max(ONE - a * a * s * s, least))
        slope += b / wp.sqrt(wp.max(ONE - b * b * s * s, least))
        step = f / wp.min(wp.cos(x) * slope - wp.float64(2.0), wp.float64(-1.0e-6))
        x = wp.clamp(x - step, ZERO, right)
        if wp.abs(step) < wp.float64(1.0e-14):
            break
    first = p
    angle = x - wp.asin(a * wp.sin(x))
    if turn < ZERO:
        first = q
        angle = x - wp.asin(b * wp.sin(x))
    first = radius * wp.normalize(first)
    c = wp.cos(angle)
    s = wp.sin(angle)
    out.length = ZERO
    out.first = wp.vec3d(c * first[0] - s * first[1], s * first[0] + c * first[1], ZERO)
    out.last = out.first
    return out


@wp.func
def wrap(
    p: wp.vec3d,
    q: wp.vec3d,
    kind: int,
    radius: wp.float64,
    side: wp.vec3d,
    has_side: bool,
    taken: int,
    known: int,
) -> Wrap:
    """The arc of a path from p to q around a geom, in the geom's frame; a length below 0 for none.

    Around a cylinder the path climbs in proportion to its length across the axis. A side site
    inside of the geom has the path run through the geom instead of around it.
    """
    axis0 = wp.vec3d(ONE, ZERO, ZERO)
    axis1 = wp.vec3d(ZERO, ONE, ZERO)
    if kind == SPHERE:
        axis0 = wp.normalize(p)
        normal = wp.cross(p, q)
        if wp.length_sq(normal) < wp.float64(1.0e-20) * wp.length_sq(p) * wp.length_sq(q):
            # all planes are as good; MuJoCo takes this one
            most = int(0)
            for k in range(1, 3):
                if wp.abs(axis0[k]) > wp.abs(axis0[most]):
                    most = k
            normal = wp.vec3d(ONE, ONE, ONE)
            normal[most] = ZERO
            normal = wp.cross(axis0, normal)
        axis1 = wp.cross(wp.normalize(normal), axis0)
    flat_p = wp.vec2d(wp.dot(p, axis0), wp.dot(p, axis1))
    flat_q = wp.vec2d(wp.dot(q, axis0), wp.dot(q, axis1))
    flat_side = wp.vec2d(wp.dot(side, axis0), wp.dot(side, axis1))
    out = Wrap()
    if has_side and wp.length(side) < radius:
        out = inside_circle(flat_p, flat_q, radius, taken)
    else:
        out = around_circle(flat_p, flat_q, flat_side, has_side, radius, known)
    if out.length < ZERO:
        return out
    first = out.first[0] * axis0 + out.first[1] * axis1
    last = out.last[0] * axis0 + out.last[1] * axis1
    along = out.along[0] * axis0 + out.along[1] * axis1
    if kind == CYLINDER:
        before = wp.length(flat_p - wp.vec2d(out.first[0], out.first[1]))
        after = wp.length(flat_q - wp.vec2d(out.last[0], out.last[1]))
        if out.back > ZERO:
            before = -out.back
        elif out.back < ZERO:
            after = out.back
        climb = (q[2] - p[2]) / wp.max(before + out.length + after, COINCIDENT)
        first[2] = p[2] + climb * before
        last[2] = p[2] + climb * (before + out.length)
        steep = wp.sqrt(ONE + climb * climb)
        out.length *= steep
        out.back *= steep
        along = wp.vec3d(along[0], along[1], climb) / steep
    out.first = first
    out.last = last
    out.along = along
    return out


@wp.func
def single(v: wp.vec3d) -> wp.vec3:
    """A vector in float32."""
    return wp.vec3(wp.float32(v[0]), wp.float32(v[1]), wp.float32(v[2]))


@wp.func
def double(v: wp.vec3) -> wp.vec3d:
    """A vector in float64."""
    return wp.vec3d(wp.float64(v[0]), wp.float64(v[1]), wp.float64(v[2]))


@wp.func
def add_span(
    a: int,
    b: int,
    start: wp.vec3d,
    end: wp.vec3d,
    share: wp.float64,
    at: int,
    spans: wp.array[TendonSpan],
) -> wp.float64:
    """Notes a straight span between two elements of a path; returns its share of the length."""
    span = TendonSpan()
    across = end - start
    length = wp.length(across)
    if length > COINCIDENT:
        span.along = single(across / length)
    span.length = wp.float32(length)
    span.a = a
    span.b = b
    span.start = single(start)
    span.end = single(end)
    span.share = wp.float32(share)
    spans[at] = span
    return share * length


@wp.func
def run_back(at: int, share: wp.float64, arc: Wrap, spans: wp.array[TendonSpan]) -> wp.float64:
    """Has a span run backwards; returns its share of the length."""
    spans[at].along = single(arc.along)
    spans[at].length = wp.float32(wp.abs(arc.back))
    return -share * wp.abs(arc.back)


@wp.func
def reach_images(at: int, radius: float, spans: wp.array[TendonSpan]):
    """How far two spans reach that meet at a ring.

    As an end moves, the point where they meet goes along the ring. So a span turns about the image
    of its other end in the ring, a convex mirror, and not about that point, which an end comes
    close to.
    """
    first = spans[at - 1].length
    last = spans[at].length
    turned = wp.dot(spans[at - 1].along, spans[at].along)
    steep = wp.sqrt(wp.max(0.5 * (1.0 - turned), 0.0))
    bent = 2.0 / (radius * wp.max(steep, SHORTEST))
    spans[at - 1].length = first + 1.0 / (1.0 / wp.max(last, SHORTEST) + bent)
    spans[at].length = last + 1.0 / (1.0 / wp.max(first, SHORTEST) + bent)


@wp.func
def far_outside(last: int, geom: int, k: int, tendons: wp.ref[TendonModel]) -> wp.float64:
    """How far outside of a geom the nearer one of two sites of a path is [m], if the path runs
    through the geom; 0 elsewhere."""
    center = tendons.point[geom]
    radius = wp.float64(tendons.value[geom])
    if tendons.kind[geom + 1] != SIDE or wp.length(tendons.point[geom + 1] - center) >= radius:
        return ZERO
    p = tendons.point[last] - center
    q = tendons.point[k] - center
    if tendons.kind[geom] == CYLINDER:
        axis = double(wp.quat_rotate(tendons.rotation[geom], wp.vec3(0.0, 0.0, 1.0)))
        p -= wp.dot(p, axis) * axis
        q -= wp.dot(q, axis) * axis
    return wp.min(wp.length(p), wp.length(q)) - radius


@wp.func
def side_taken(
    last: int, geom: int, k: int, ahead: wp.float64, tendons: wp.ref[TendonModel]
) -> int:
    """The side of a geom on which a path that runs through it is taken to end within the step.

    An ``ahead`` of 0 or more chooses it, by where the nearer end then is after that share of a
    step.
    """
    now = far_outside(last, geom, k, tendons)
    known = tendons.outside[geom]
    if ahead >= ZERO:
        known = wp.vec3d(now, now, now + ahead * (now - known[0]))
    known[1] = now
    tendons.outside[geom] = known
    return wp.where(known[2] > ZERO, OUTSIDE, WITHIN)


@wp.func
def meets_kink(k: int, tendons: wp.ref[TendonModel]) -> bool:
    """Whether a path is to jump to another way around a geom, or an end of it has passed the
    surface in the step, or will in the next one if it goes on."""
    if tendons.way[k][1] != 0:
        return True
    started = tendons.outside[k][0]
    now = tendons.outside[k][1]
    then = now + (now - started)
    return (now > ZERO) != (started > ZERO) or (now > ZERO) != (then > ZERO)


@wp.func
def arc_of(
    last: int, geom: int, k: int, taken: int, known: int, tendons: wp.ref[TendonModel]
) -> Wrap:
    """The arc between two sites of a path around a geom, from the origin of the tendon."""
    center = tendons.point[geom]
    turned = tendons.rotation[geom]
    axes = wp.quatd(
        wp.float64(turned[0]), wp.float64(turned[1]), wp.float64(turned[2]), wp.float64(turned[3])
    )
    out = wrap(
        wp.quat_rotate_inv(axes, tendons.point[last] - center),
        wp.quat_rotate_inv(axes, tendons.point[k] - center),
        tendons.kind[geom],
        wp.float64(tendons.value[geom]),
        wp.quat_rotate_inv(axes, tendons.point[geom + 1] - center),
        tendons.kind[geom + 1] == SIDE,
        taken,
        known,
    )
    out.first = center + wp.quat_rotate(axes, out.first)
    out.last = center + wp.quat_rotate(axes, out.last)
    out.along = wp.quat_rotate(axes, out.along)
    return out


@wp.func
def find_path(i: int, in_step: bool, ahead: wp.float64, tendons: wp.ref[TendonModel]) -> wp.float64:
    """Spans of a spatial tendon by where its elements are, and its length [m].

    A path that runs through a geom is shortest, with a kink, where one of its ends is on the
    surface. Within a step its length goes on without the kink, on the side that
    :func:`side_taken` chooses: a light end that a tendon pulls there would be held by the kink
    otherwise, from sweep to sweep on the other side, and by its jumps the tendon would pull nothing
    else as it should. Where a side site has the length jump, as the path goes the other way around
    a geom or leaves it for a shorter one, a step goes on by the way on which it starts: by a jump
    within the step what acts along the tendon would throw it back.
    """
    length = wp.float64(0.0)
    share = wp.float64(1.0)
    last = int(-1)
    geom = int(-1)
    at = int(tendons.start[i])
    for k in range(tendons.start[i], tendons.start[i + 1]):
        kind = tendons.kind[k]
        if kind == PULLEY:
            share = ONE / wp.float64(tendons.value[k])
            last = -1
            geom = -1
        elif kind == SPHERE or kind == CYLINDER:
            geom = k
        elif kind == SITE:
            if last >= 0:
                start = tendons.point[last]
                end = tendons.point[k]
                from_ = int(last)
                arc = Wrap()
                if geom >= 0:
                    taken = int(WHERE_IT_IS)
                    known = int(UNKNOWN)
                    if in_step:
                        taken = side_taken(last, geom, k, ahead, tendons)
                        if ahead < ZERO:
                            known = tendons.way[geom][0]
                    arc = arc_of(last, geom, k, taken, known, tendons)
                    if in_step:
                        way = arc.way
                        if known != UNKNOWN:
                            way[0] = known
                        tendons.way[geom] = way
                    if arc.length >= ZERO:
                        length += share * arc.length
                        part = add_span(last, geom, start, arc.first, share, at, tendons.spans)
                        if arc.back > ZERO:
                            part = run_back(at, share, arc, tendons.spans)
                        length += part
                        at += 1
                        start = arc.last
                        from_ = geom
                part = add_span(from_, k, start, end, share, at, tendons.spans)
                if arc.back < ZERO:
                    part = run_back(at, share, arc, tendons.spans)
                length += part
                if geom >= 0 and from_ == geom and arc.length == ZERO:
                    reach_images(at, tendons.value[geom], tendons.spans)
                at += 1
            last = k
            geom = -1
    tendons.span_end[i] = at
    return length

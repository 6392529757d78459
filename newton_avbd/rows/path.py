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
    """Where a line through a point outside of a circle about the origin touches it."""
    square = wp.dot(p, p)
    root = sign * radius * wp.sqrt(wp.max(square - radius * radius, ZERO))
    return (radius * radius * p + root * wp.vec2d(p[1], -p[0])) / square


@wp.func
def around_circle(
    p: wp.vec2d, q: wp.vec2d, side: wp.vec2d, has_side: bool, radius: wp.float64
) -> Wrap:
    """The path from p to q around a circle, on the given side or, without one, on the shorter."""
    out = Wrap()
    out.length = -ONE
    across = q - p
    square = wp.dot(across, across)
    is_inside = wp.min(wp.dot(p, p), wp.dot(q, q)) < radius * radius
    if is_inside or square < COINCIDENT * COINCIDENT or radius < COINCIDENT:
        return out
    near = p + wp.clamp(-wp.dot(across, p) / square, ZERO, ONE) * across
    if wp.dot(near, near) > radius * radius:
        if not has_side or wp.dot(side, near) >= ZERO:
            return out
    best = -wp.float64(wp.inf)
    for i in range(2):
        sign = wp.where(i == 0, ONE, -ONE)
        a = touching(p, radius, sign)
        b = touching(q, radius, -sign)
        if crosses(p, a, q, b):
            continue
        good = -wp.length_sq(a - b)
        if has_side:
            good = wp.dot(wp.normalize(a + b), side)
        if good >= best:
            best = good
            angle = wp.atan2(sign * (b[0] * a[1] - b[1] * a[0]), wp.dot(a, b))
            # less than none at all is rounding of two points that coincide
            whole = wp.where(angle < wp.float64(-1.0e-6), wp.float64(2.0) * HALF_TURN, ZERO)
            out.length = radius * wp.max(angle + whole, ZERO)
            out.first = wp.vec3d(a[0], a[1], ZERO)
            out.last = wp.vec3d(b[0], b[1], ZERO)
    return out


@wp.func
def inside_circle(p: wp.vec2d, q: wp.vec2d, radius: wp.float64) -> Wrap:
    """The path from p to q that a ring holds from outside: straight through it, or by the point of
    the ring at which its two spans make equal angles with the ring."""
    out = Wrap()
    out.length = -ONE
    far_p = wp.length(p)
    far_q = wp.length(q)
    if wp.min(far_p, far_q) <= radius or radius < COINCIDENT:
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
    p: wp.vec3d, q: wp.vec3d, kind: int, radius: wp.float64, side: wp.vec3d, has_side: bool
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
            least = int(0)
            for k in range(1, 3):
                if wp.abs(axis0[k]) < wp.abs(axis0[least]):
                    least = k
            normal = wp.vec3d(ZERO, ZERO, ZERO)
            normal[least] = ONE
            normal = wp.cross(axis0, normal)
        axis1 = wp.cross(wp.normalize(normal), axis0)
    flat_p = wp.vec2d(wp.dot(p, axis0), wp.dot(p, axis1))
    flat_q = wp.vec2d(wp.dot(q, axis0), wp.dot(q, axis1))
    flat_side = wp.vec2d(wp.dot(side, axis0), wp.dot(side, axis1))
    out = Wrap()
    if has_side and wp.length(side) < radius:
        out = inside_circle(flat_p, flat_q, radius)
    else:
        out = around_circle(flat_p, flat_q, flat_side, has_side, radius)
    if out.length < ZERO:
        return out
    first = out.first[0] * axis0 + out.first[1] * axis1
    last = out.last[0] * axis0 + out.last[1] * axis1
    if kind == CYLINDER:
        before = wp.length(flat_p - wp.vec2d(out.first[0], out.first[1]))
        after = wp.length(flat_q - wp.vec2d(out.last[0], out.last[1]))
        climb = (q[2] - p[2]) / wp.max(before + out.length + after, COINCIDENT)
        first[2] = p[2] + climb * before
        last[2] = p[2] + climb * (before + out.length)
        out.length *= wp.sqrt(ONE + climb * climb)
    out.first = first
    out.last = last
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
def arc_of(last: int, geom: int, k: int, tendons: wp.ref[TendonModel]) -> Wrap:
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
    )
    out.first = center + wp.quat_rotate(axes, out.first)
    out.last = center + wp.quat_rotate(axes, out.last)
    return out


@wp.func
def find_path(i: int, tendons: wp.ref[TendonModel]) -> wp.float64:
    """Spans of a spatial tendon by where its elements are, and its length [m]."""
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
                if geom >= 0:
                    arc = arc_of(last, geom, k, tendons)
                    if arc.length >= ZERO:
                        length += share * arc.length
                        length += add_span(last, geom, start, arc.first, share, at, tendons.spans)
                        at += 1
                        start = arc.last
                        from_ = geom
                length += add_span(from_, k, start, end, share, at, tendons.spans)
                at += 1
            last = k
            geom = -1
    tendons.span_end[i] = at
    return length

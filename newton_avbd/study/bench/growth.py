# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""How time and memory of SolverAVBD grow with a scene: families of scenes of any size."""

import math
import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import median
from typing import Any

import newton
import numpy as np
import warp as wp

from newton_avbd import SolverAVBD
from newton_avbd.scenes.named import add_ground, add_pyramid
from newton_avbd.scenes.robots import add_ant
from newton_avbd.setup.memory import bytes_by_effect

DT = 1.0 / 240.0
COLD_STEPS = 4
"""Steps before those that are timed: the first three sweep more."""
STEPS = 9
"""Steps that are timed, the same at all sizes."""
LARGE = 1000
"""Bodies from which on growth is measured: below, a step's fixed cost hides it."""
EDGE = 0.5
"""Edge of a box [m]."""
ABOVE = 0.2
"""How far above the ground the ant starts in its own scene [m]."""


@dataclass(frozen=True)
class Family:
    """A scene of any size.

    Attributes:
        summary: One line that says what it is.
        build: Puts about so many bodies into an empty builder.
        most: Most bodies that Newton builds in reasonable time.
    """

    summary: str
    build: Callable[[newton.ModelBuilder, int], None]
    most: int = 10**6


@dataclass(frozen=True)
class Point:
    """What was measured on a scene of one size.

    Attributes:
        family: Name of the family.
        bodies: Bodies.
        joints: Joints, without those of free bodies.
        contacts: Contacts in the last step.
        worlds: Worlds.
        sweeps: Most sweeps that a world took in the last step.
        construction: Processor time to construct the solver [s].
        step: Time of a step without detection, median [s]; processor time on a CPU.
        memory: Memory of the solver's arrays [bytes].
    """

    family: str
    bodies: int
    joints: int
    contacts: int
    worlds: int
    sweeps: int
    construction: float
    step: float
    memory: int


def _add_boxes(builder: newton.ModelBuilder, count: int) -> None:
    """Boxes on the ground, each by itself."""
    side = math.ceil(math.sqrt(count))
    row = newton.ModelBuilder()
    box = newton.ModelBuilder()
    _add_box(box, 0.0, 0.5 * EDGE)
    row.replicate(box, side, spacing=(2.0 * EDGE, 0.0, 0.0), separate_worlds=False)
    builder.replicate(
        row, math.ceil(count / side), spacing=(0.0, 2.0 * EDGE, 0.0), separate_worlds=False
    )
    add_ground(builder, gap=EDGE / 8.0)


def _add_wall(builder: newton.ModelBuilder, count: int) -> None:
    """A brick wall of ten courses."""
    courses = newton.ModelBuilder()
    for i in range(10):
        _add_box(courses, 0.5 * EDGE * (i % 2), (i + 0.5) * EDGE)
    spacing = (1.01 * EDGE, 0.0, 0.0)
    builder.replicate(courses, math.ceil(count / 10), spacing=spacing, separate_worlds=False)
    add_ground(builder, gap=EDGE / 8.0)


def _add_pyramid(builder: newton.ModelBuilder, count: int) -> None:
    """A pyramid, its height the root of twice the boxes."""
    add_pyramid(builder, rows=round(math.sqrt(2.0 * count)))


def _add_chain(builder: newton.ModelBuilder, count: int) -> None:
    """One chain, held at an end, that starts to fall from level."""
    joints, parent = [], -1
    for i in range(count):
        link = _add_link(builder, (EDGE * i, 0.0, 0.0))
        joints.append(_join(builder, parent, link, (EDGE, 0.0, 0.0)))
        parent = link
    builder.add_articulation(joints)


def _add_ropes(builder: newton.ModelBuilder, count: int) -> None:
    """Chains of ten links."""
    rope = newton.ModelBuilder()
    _add_chain(rope, 10)
    builder.replicate(rope, math.ceil(count / 10), spacing=(EDGE, 0.0, 0.0), separate_worlds=False)


def _add_net(builder: newton.ModelBuilder, count: int) -> None:
    """A square net of ball joints that hangs from two corners; most joints close loops."""
    side = round(math.sqrt(count))
    links = {
        (i, j): _add_link(builder, (EDGE * i, 0.0, -EDGE * j))
        for i in range(side)
        for j in range(side)
    }
    for (i, j), link in links.items():
        for step in ((1, 0), (0, 1)):
            other = links.get((i + step[0], j + step[1]))
            if other is not None:
                _join(builder, link, other, (EDGE * step[0], 0.0, -EDGE * step[1]))
    for corner in (0, side - 1):
        _join(builder, -1, links[corner, 0], (0.0, 0.0, 0.0), (EDGE * corner, 0.0, 0.0))


def _add_ants(builder: newton.ModelBuilder, count: int) -> None:
    """Worlds with an ant in each."""
    world = newton.ModelBuilder()
    add_ant(world)
    down = wp.transform((0.0, 0.0, -ABOVE), wp.quat_identity())
    world.body_q = [down * pose for pose in world.body_q]
    builder.replicate(world, math.ceil(count / world.body_count))


def _add_box(builder: newton.ModelBuilder, x: float, z: float) -> None:
    cfg = newton.ModelBuilder.ShapeConfig(mu=0.5, gap=EDGE / 8.0)
    body = builder.add_body(xform=wp.transform((x, 0.0, z), wp.quat_identity()))
    builder.add_shape_box(body, hx=0.5 * EDGE, hy=0.5 * EDGE, hz=0.5 * EDGE, cfg=cfg)


def _add_link(builder: newton.ModelBuilder, center: tuple[float, float, float]) -> int:
    link = builder.add_link(xform=wp.transform(center, wp.quat_identity()))
    cfg = newton.ModelBuilder.ShapeConfig(has_shape_collision=False)
    builder.add_shape_sphere(link, radius=0.4 * EDGE, cfg=cfg)
    return link


def _join(
    builder: newton.ModelBuilder,
    parent: int,
    child: int,
    apart: tuple[float, float, float],
    anchor: tuple[float, float, float] | None = None,
) -> int:
    """A ball joint half way between two links; of the world, at ``anchor`` or above the child."""
    half = 0.5 * np.array(apart)
    start = half if parent >= 0 else (anchor or -half)
    return builder.add_joint_ball(
        parent,
        child,
        parent_xform=wp.transform(wp.vec3(*start), wp.quat_identity()),
        child_xform=wp.transform(wp.vec3(*(-half)), wp.quat_identity()),
    )


FAMILIES = {
    "boxes": Family("boxes on the ground, each by itself", _add_boxes),
    "wall": Family("a brick wall, ten courses high", _add_wall),
    "pyramid": Family("a pyramid that grows in height", _add_pyramid, most=10**4),
    "ropes": Family("chains of ten links", _add_ropes),
    "chain": Family("one chain", _add_chain, most=10**4),
    "net": Family("a net of joints, most of which close loops", _add_net, most=10**4),
    "ants": Family("worlds with an ant in each", _add_ants),
}
"""The scenes by name."""

QUANTITIES = {
    "step": "time of a step [s]",
    "construction": "time to construct the solver [s]",
    "memory": "memory of the solver [bytes]",
}
"""What is to grow in proportion at most, and how an axis calls it."""


def measure(name: str, bodies: int, device: str | None = None) -> Point:
    """Build a family's scene, construct a solver and take some steps.

    Args:
        name: Of the family.
        bodies: About how many.
        device: Warp device; None for the current one.

    Returns:
        What was measured, on one core where the device is a CPU.
    """
    builder = newton.ModelBuilder()
    FAMILIES[name].build(builder, bodies)
    # a net closes loops, which joints of no articulation may
    model = builder.finalize(device=device, skip_validation_joints=True)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        begin = time.process_time()
        solver = SolverAVBD(model, workers=1)
        construction = time.process_time() - begin
        pipeline = None
        if model.shape_contact_pair_count:
            # more than there are: no box is near more than six others, or has more than 16 contacts
            pipeline = newton.CollisionPipeline(
                model,
                broad_phase="sap",
                rigid_contact_max=16 * model.body_count + 1000,
                shape_pairs_max=8 * model.shape_count + 1000,
            )
        contacts = pipeline.contacts() if pipeline else None
        state, other = model.state(), model.state()
        times: list[float] = []
        for _ in range(COLD_STEPS + STEPS):
            if pipeline:
                pipeline.collide(state, contacts)
            begin = _clock(model.device)
            solver.step(state, other, None, contacts, DT)
            times.append(_clock(model.device) - begin)
            state, other = other, state
    count = 0 if contacts is None else int(contacts.rigid_contact_count.numpy()[0])
    if solver.status.contact_overflow > 0 or np.any(solver.status.held_steps):
        raise RuntimeError(f"{name} with {bodies} bodies is not simulated as it is meant to be")
    free = int(np.sum(model.joint_type.numpy() == int(newton.JointType.FREE)))
    return Point(
        family=name,
        bodies=model.body_count,
        joints=model.joint_count - free,
        contacts=count,
        worlds=model.world_count,
        sweeps=int(solver.status.sweeps.max()),
        construction=construction,
        step=median(times[COLD_STEPS:]),
        memory=sum(bytes_by_effect(solver).values()),
    )


def sizes(name: str, most: int) -> Iterator[int]:
    """Ten bodies and ten times as many again, up to a size."""
    size = 10
    while size <= min(most, FAMILIES[name].most):
        yield size
        size *= 10


def exponent(points: list[Point], quantity: str) -> float:
    """Power of the bodies with which a quantity of one family grows; nan where that is not known.

    Of the straight line through the points from :data:`LARGE` bodies on, both axes logarithmic.
    """
    large = [point for point in points if point.bodies >= 0.9 * LARGE]
    if len(large) < 2:
        return math.nan
    x = np.log([point.bodies for point in large])
    return float(np.polyfit(x, np.log([getattr(p, quantity) for p in large]), 1)[0])


def rows(points: list[Point]) -> list[list[str]]:
    """A table of all points, with its head."""
    head = ["scene", "bodies", "joints", "contacts", "worlds", "sweeps"]
    head += ["construction", "step", "a body", "memory", "a body"]
    table = [head]
    for p in points:
        counts = (p.bodies, p.joints, p.contacts, p.worlds, p.sweeps)
        table.append(
            [
                p.family,
                *(f"{count:,}" for count in counts),
                f"{1e3 * p.construction:,.0f} ms",
                f"{1e3 * p.step:,.3g} ms" if p.step < 1.0 else f"{1e3 * p.step:,.0f} ms",
                f"{1e6 * p.step / p.bodies:.3g} us",
                f"{p.memory / 2**20:,.3g} MiB"
                if p.memory < 2**30
                else f"{p.memory / 2**20:,.0f} MiB",
                f"{p.memory / p.bodies:,.0f} B",
            ]
        )
    return table


def exponents(points: list[Point]) -> list[list[str]]:
    """A table of the powers with which each family grows, with its head."""
    table = [["scene", *QUANTITIES]]
    for name in dict.fromkeys(point.family for point in points):
        mine = [point for point in points if point.family == name]
        powers = (exponent(mine, quantity) for quantity in QUANTITIES)
        table.append([name, *("-" if math.isnan(p) else f"{p:.2f}" for p in powers)])
    return table


def as_json(machine: dict[str, str], points: list[Point]) -> dict[str, Any]:
    """Everything that was measured, times in seconds, memory in bytes."""
    return {"machine": machine, "points": [asdict(point) for point in points]}


def write_plot(points: list[Point], quantity: str, file: Path) -> None:
    """Draw a quantity against the bodies of all families, both axes logarithmic.

    Args:
        points: What was measured.
        quantity: One of :data:`QUANTITIES`.
        file: An SVG file to write.
    """
    import matplotlib

    with matplotlib.rc_context({"svg.hashsalt": quantity, "svg.fonttype": "none"}):
        from matplotlib.figure import Figure

        figure = Figure(figsize=(6.0, 4.0), layout="constrained")
        axes = figure.subplots()
        for name in dict.fromkeys(point.family for point in points):
            mine = [point for point in points if point.family == name]
            values = [getattr(point, quantity) for point in mine]
            axes.plot([point.bodies for point in mine], values, marker="o", ms=3, label=name)
        axes.set(xscale="log", yscale="log", xlabel="bodies", ylabel=QUANTITIES[quantity])
        low, high = axes.get_xlim()
        bottom = axes.get_ylim()[0]
        axes.plot([low, high], [bottom, bottom * high / low], "k:", lw=1, label="in proportion")
        axes.set(xlim=(low, high))
        axes.minorticks_off()
        axes.grid(alpha=0.3)
        axes.legend(fontsize=8)
        figure.savefig(file, format="svg", metadata={"Date": None})


def _clock(device: wp.Device) -> float:
    """Processor time, or where a GPU works the time when it is done [s]."""
    if device.is_cuda:
        wp.synchronize_device(device)
        return time.perf_counter()
    return time.process_time()

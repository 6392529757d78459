# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""Properties of Newton's tendons, cables through guides, and the closed forms that they follow."""

import math

import newton
import numpy as np
import warp as wp
from newton import TendonGuide, TendonGuideType

from newton_avbd.study.properties.property import Catalog, Measure, after

G = 9.81
"""Gravity [m/s^2], along -z."""
R = 0.2
"""Radius of rollers [m]."""
Y = (0.0, 1.0, 0.0)
STIFF = 1.0e-5
"""Compliance of cables that are all but inextensible [m/N], as Newton's examples have it:
SolverXPBD and SolverVBD need some to let a cable slip."""

CABLES = Catalog()
"""Properties by name."""


def weight(builder: newton.ModelBuilder, mass: float, x: float, z: float) -> int:
    """A free body."""
    inertia = wp.mat33(np.eye(3) * 0.004 * mass)
    place = wp.transform(wp.vec3(x, 0.0, z), wp.quat_identity())
    return builder.add_body(xform=place, mass=mass, inertia=inertia)


def over_roller(builder: newton.ModelBuilder, is_authored: bool, mu: float) -> Measure:
    """1 kg and 2 kg on a cable over a roller that is fixed in space; measures how 1 kg rises."""
    ends = weight(builder, 1.0, -R, -2.0), weight(builder, 2.0, R, -2.0)
    if is_authored:
        over = TendonGuide(
            body=-1, guide_type=TendonGuideType.ROLLER, radius=R, mu=mu, axis=Y, compliance=STIFF
        )
        end = TendonGuide(body=ends[1], compliance=STIFF)
        builder.add_tendon([TendonGuide(body=ends[0]), over, end])
    return after(0.5, lambda trial: trial.velocity(ends[0])[2] / 0.5)


@CABLES.declare(
    "tendon: Atwood",
    "1 kg and 2 kg on a cable of 0.01 mm/N over a roller without friction: g/3.",
    expected=G / 3.0,
    bound=0.005 * G / 3.0,
    unit="m/s^2",
)
def _(builder: newton.ModelBuilder, authored: bool) -> Measure:
    return over_roller(builder, authored, 0.0)


@CABLES.declare(
    "tendon: capstan slips",
    "The same with mu = 0.1 over half a turn, k = e^(0.1 pi): (2 - k)/(2 + k) g.",
    expected=(2.0 - math.exp(0.1 * math.pi)) / (2.0 + math.exp(0.1 * math.pi)) * G,
    bound=0.01 * G / 3.0,
    unit="m/s^2",
)
def _(builder: newton.ModelBuilder, authored: bool) -> Measure:
    return over_roller(builder, authored, 0.1)


@CABLES.declare(
    "tendon: capstan holds",
    "The same with mu = 0.3, which holds 2.57 of tension against 1.",
    expected=0.0,
    bound=0.001,
    unit="m/s^2",
)
def _(builder: newton.ModelBuilder, authored: bool) -> Measure:
    return over_roller(builder, authored, 0.3)


@CABLES.declare(
    "tendon: inextensible",
    "1 kg on a cable, and 1,000 kg on another one below it: neither stretches.",
    expected=0.0,
    bound=1.0e-4,
    unit="m",
)
def _(builder: newton.ModelBuilder, authored: bool) -> Measure:
    light, heavy = weight(builder, 1.0, 0.0, -1.0), weight(builder, 1000.0, 0.0, -2.0)
    if authored:
        builder.add_tendon([TendonGuide(body=-1), TendonGuide(body=light)])
        builder.add_tendon([TendonGuide(body=light), TendonGuide(body=heavy)])
    return after(1.0, lambda trial: -2.0 - trial.center(heavy)[2])


@CABLES.declare(
    "tendon: compliance, damping",
    "2 kg on a cable of 0.1 mm/N and 200 N s/m: it hangs m g c lower.",
    expected=2.0 * G * 1.0e-4,
    bound=0.01 * 2.0 * G * 1.0e-4,
    unit="m",
)
def _(builder: newton.ModelBuilder, authored: bool) -> Measure:
    body = weight(builder, 2.0, 0.0, -1.0)
    if authored:
        end = TendonGuide(body=body, compliance=1.0e-4, damping=200.0)
        builder.add_tendon([TendonGuide(body=-1), end])
    return after(1.0, lambda trial: -1.0 - trial.center(body)[2])


@CABLES.declare(
    "tendon: moving pulley",
    "3 kg in the loop of a cable from whose end 1 kg hangs: it falls with g/7.",
    expected=-G / 7.0,
    bound=0.01 * G / 7.0,
    unit="m/s^2",
)
def _(builder: newton.ModelBuilder, authored: bool) -> Measure:
    pulley, body = weight(builder, 3.0, 0.0, -1.0), weight(builder, 1.0, 2.0 * R, -1.0)
    if authored:
        roller = {"guide_type": TendonGuideType.ROLLER, "axis": Y, "compliance": STIFF}
        place = (1.25 * R, 0.0, 0.0)
        builder.add_tendon(
            [
                TendonGuide(body=-1, offset=(-0.5 * R, 0.0, 0.0)),
                TendonGuide(body=pulley, radius=0.5 * R, orientation=-1, **roller),
                TendonGuide(body=-1, radius=0.75 * R, offset=place, **roller),
                TendonGuide(body=body, compliance=STIFF),
            ]
        )
    return after(0.5, lambda trial: trial.velocity(pulley)[2] / 0.5)


@CABLES.declare(
    "tendon: goes taut",
    "1 kg falls 0.8 m until its cable stops it: it does not rise again.",
    expected=-1.0,
    bound=1.0e-3,
    unit="m",
)
def _(builder: newton.ModelBuilder, authored: bool) -> Measure:
    body = weight(builder, 1.0, 0.0, -0.2)
    if authored:
        builder.add_tendon([TendonGuide(body=-1), TendonGuide(body=body, rest_length=1.0)])
    return after(0.6, lambda trial: max(trial.center(body)[2] for _ in trial.steps(1.0)))


@CABLES.declare(
    "tendon: pinhole with friction",
    "1 kg and 2 kg beside each other on a cable through a pinhole, mu = 0.1: as over half a turn.",
    expected=(2.0 - math.exp(0.1 * math.pi)) / (2.0 + math.exp(0.1 * math.pi)) * G,
    bound=0.01 * G / 3.0,
    unit="m/s^2",
)
def _(builder: newton.ModelBuilder, authored: bool) -> Measure:
    ends = weight(builder, 1.0, -1.0e-4, -2.0), weight(builder, 2.0, 1.0e-4, -2.0)
    if authored:
        pinhole = TendonGuideType.PINHOLE
        through = TendonGuide(body=-1, guide_type=pinhole, mu=0.1, compliance=STIFF)
        end = TendonGuide(body=ends[1], compliance=STIFF)
        builder.add_tendon([TendonGuide(body=ends[0]), through, end])
    return after(0.5, lambda trial: trial.velocity(ends[0])[2] / 0.5)

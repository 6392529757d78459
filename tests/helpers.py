# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""What several test files share: a scene that is stepped, and how a test looks at it."""

from collections.abc import Callable, Iterable
from typing import Any

import newton
import numpy as np
import pytest
import warp as wp
from newton.solvers import SolverBase
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from newton_avbd import SolverAVBD
from newton_avbd.measure.state import Bodies
from newton_avbd.model.rotations import transform
from newton_avbd.scenes.chains import add_chain
from newton_avbd.study.accuracy import pendulums

Array = NDArray[np.float64]

EPS = float(np.finfo(np.float32).eps)
"""Distance from 1 to the next float32: one rounding is off by at most half of it."""

G = 9.81
"""Newton's default gravity [m/s^2], along -z."""

NO_GRAVITY = (0.0, 0.0, 0.0)

IDENTITY = wp.quat_identity()


class Simulation:
    """A model, a solver and its buffers, advanced step by step, seen in double precision."""

    def __init__(
        self,
        builder: newton.ModelBuilder,
        *,
        dt: float = 1.0 / 240.0,
        collide: bool = True,
        make_solver: Callable[..., SolverBase] = SolverAVBD,
        keep_inertia: bool = False,
        is_checked: bool = True,
        **settings: Any,
    ) -> None:
        """Finalizes ``builder``; ``settings`` go to the solver, ``collide`` detects each step.

        ``keep_inertia`` leaves moments of inertia as they are that Newton thinks too small;
        ``is_checked=False`` takes what Newton would refuse.
        """
        self.dt = dt
        self.model = builder.finalize(
            device="cpu",
            skip_validation_inertia=keep_inertia,
            skip_all_validations=not is_checked,
        )
        self.pipeline = newton.CollisionPipeline(self.model) if collide else None
        self.contacts = self.pipeline.contacts() if self.pipeline else None
        self.solver = make_solver(self.model, **settings)
        self.control = self.model.control()
        self.state = self.model.state()
        self._next = self.model.state()
        self.observables = None

    def observe(self, *kinds: str) -> SolverBase.Observables:
        """Asks for observables, from the next step on."""
        self.observables = self.solver.observables(kinds, contacts=self.contacts)
        return self.observables

    def step(self, count: int = 1) -> None:
        """Detects contacts and steps, ``count`` times; ``body_f`` stays as it is."""
        for _ in range(count):
            if self.pipeline is not None:
                self.pipeline.collide(self.state, self.contacts)
            wp.copy(self._next.body_f, self.state.body_f)
            self.solver.step(
                self.state,
                self._next,
                self.control,
                self.contacts,
                self.dt,
                observables=self.observables,
            )
            self.state, self._next = self._next, self.state

    def run(self, seconds: float) -> None:
        """Steps for a time [s]."""
        self.step(round(seconds / self.dt))

    @property
    def pose(self) -> Array:
        """Body poses (position [m], quaternion xyzw), shape (body_count, 7)."""
        return self.state.body_q.numpy().astype(np.float64)

    @property
    def velocity(self) -> Array:
        """Body velocities (of the COM [m/s], angular [rad/s]), shape (body_count, 6)."""
        return self.state.body_qd.numpy().astype(np.float64)

    @property
    def center(self) -> Array:
        """Centers of mass [m], world frame, shape (body_count, 3)."""
        com = self.model.body_com.numpy().astype(np.float64)
        pose = self.pose
        return pose[:, :3] + Rotation.from_quat(pose[:, 3:]).apply(com)

    @property
    def mass(self) -> Array:
        """Masses [kg]."""
        return self.model.body_mass.numpy().astype(np.float64)

    @property
    def world_inertia(self) -> Array:
        """Inertia tensors about the COM, world axes [kg m^2], shape (body_count, 3, 3)."""
        r = Rotation.from_quat(self.pose[:, 3:]).as_matrix()
        return r @ self.model.body_inertia.numpy().astype(np.float64) @ r.transpose(0, 2, 1)

    @property
    def spin_momentum(self) -> Array:
        """Angular momenta about each body's COM [N m s], shape (body_count, 3)."""
        return np.einsum("nij,nj->ni", self.world_inertia, self.velocity[:, 3:])

    @property
    def kinetic_energy(self) -> float:
        """Kinetic energy of all bodies [J]."""
        v = self.velocity
        linear = np.sum(self.mass * np.sum(v[:, :3] ** 2, axis=1))
        return 0.5 * float(linear + np.sum(v[:, 3:] * self.spin_momentum))

    @property
    def energy(self) -> float:
        """Kinetic energy and potential energy in gravity along z [J]."""
        g = self.model.gravity.numpy().astype(np.float64)[self.model.body_world.numpy()]
        return self.kinetic_energy - float(np.sum(self.mass * np.sum(g * self.center, axis=1)))

    @property
    def penetration(self) -> float:
        """Deepest penetration at the contacts of a fresh detection [m], 0 when apart."""
        self.pipeline.collide(self.state, self.contacts)
        count = int(self.contacts.rigid_contact_count.numpy()[0])
        if count == 0:
            return 0.0
        ends = []
        for side in ("0", "1"):
            shape = getattr(self.contacts, f"rigid_contact_shape{side}").numpy()[:count]
            point = getattr(self.contacts, f"rigid_contact_point{side}").numpy()[:count]
            body = self.model.shape_body.numpy()[shape]
            pose = np.vstack([self.pose, [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]])[body]
            ends.append(pose[:, :3] + Rotation.from_quat(pose[:, 3:]).apply(point))
        normal = self.contacts.rigid_contact_normal.numpy()[:count].astype(np.float64)
        margin = (
            self.contacts.rigid_contact_margin0.numpy()[:count]
            + self.contacts.rigid_contact_margin1.numpy()[:count]
        )
        gap = np.sum(normal * (ends[1] - ends[0]), axis=1) - margin
        return max(0.0, -float(gap.min()))

    def set_velocity(self, body: int, linear: Any = (0, 0, 0), angular: Any = (0, 0, 0)) -> None:
        """Sets a body's velocity (of its COM [m/s], angular [rad/s])."""
        velocity = self.state.body_qd.numpy()
        velocity[body] = [*linear, *angular]
        self.state.body_qd.assign(velocity)

    def push(self, body: int, force: Any = (0, 0, 0), torque: Any = (0, 0, 0)) -> None:
        """Sets the external force [N] and torque [N m] on a body, until it is set again."""
        wrench = self.state.body_f.numpy()
        wrench[body] = [*force, *torque]
        self.state.body_f.assign(wrench)


def marked_long(names: Iterable[str], long: tuple[str, ...]) -> list[Any]:
    """Parameters of a test, marked as long where a name begins with one of ``long``."""
    marks = pytest.mark.long
    return [pytest.param(name, marks=marks if name.startswith(long) else ()) for name in names]


def surface(
    mu: float = 0.5, density: float = 1000.0, gap: float = 0.02, **settings: Any
) -> newton.ModelBuilder.ShapeConfig:
    """A shape's material and mass: friction, density [kg/m^3], detection gap [m]."""
    return newton.ModelBuilder.ShapeConfig(mu=mu, density=density, gap=gap, **settings)


def add_box(
    builder: newton.ModelBuilder,
    position: Any,
    size: Any = 0.5,
    rotation: wp.quat = IDENTITY,
    **settings: Any,
) -> int:
    """Adds a free box with full edges ``size`` [m], of material :func:`surface`."""
    hx, hy, hz = 0.5 * np.broadcast_to(np.asarray(size, dtype=float), 3)
    body = builder.add_body(xform=wp.transform(wp.vec3(*position), rotation))
    builder.add_shape_box(body, hx=hx, hy=hy, hz=hz, cfg=surface(**settings))
    return body


def add_sphere(
    builder: newton.ModelBuilder, position: Any, radius: float = 0.25, **settings: Any
) -> int:
    """Adds a free sphere, radius [m], of material :func:`surface`."""
    body = builder.add_body(xform=wp.transform(wp.vec3(*position), IDENTITY))
    builder.add_shape_sphere(body, radius=radius, cfg=surface(**settings))
    return body


def add_ground(builder: newton.ModelBuilder, mu: float = 0.5, **settings: Any) -> None:
    """Adds the plane z = 0, of material :func:`surface`."""
    builder.add_ground_plane(cfg=surface(mu=mu, **settings))


def add_mass(
    builder: newton.ModelBuilder,
    *,
    mass: float = 1.0,
    inertia: Any = (0.1, 0.1, 0.1),
    com: Any = (0.0, 0.0, 0.0),
    position: Any = (0.0, 0.0, 0.0),
    rotation: wp.quat = IDENTITY,
) -> int:
    """Adds a free body without a shape; ``inertia`` is a tensor or its diagonal [kg m^2]."""
    tensor = np.asarray(inertia, dtype=float)
    tensor = np.diag(tensor) if tensor.ndim == 1 else tensor
    return builder.add_body(
        mass=mass,
        inertia=wp.mat33(*tensor.ravel()),
        com=wp.vec3(*com),
        xform=wp.transform(wp.vec3(*position), rotation),
    )


def in_float32(value: float) -> float:
    """What of a number reaches a kernel."""
    return float(np.float32(value))


SWING_SECONDS = 2.0
"""Time after which errors of pendulums are taken [s]."""


def pendulum_errors(
    make_solver: Callable[[newton.Model], SolverBase], links: int, dts: Iterable[float]
) -> dict[float, float]:
    """Largest distance of a link's center of mass from the reference [m], by the solver's step [s].

    A pendulum of hinged links is let go at :data:`pendulums.SLOPE`; steps are whole fractions of
    :data:`SWING_SECONDS`.
    """
    builder = newton.ModelBuilder()
    add_chain(builder, links, length=pendulums.LENGTH, slope=pendulums.SLOPE)
    builder.color()
    model = builder.finalize(device="cpu")
    belongs = pendulums.reference(model, SWING_SECONDS)
    errors = {}
    for dt in dts:
        solver, control = make_solver(model), model.control()
        state, following = model.state(), model.state()
        for _ in range(round(SWING_SECONDS / dt)):
            solver.step(state, following, control, None, dt)
            state, following = following, state
        centers = transform(state.body_q.numpy().astype(float), Bodies.of(model).com)
        errors[dt] = float(np.max(np.linalg.norm(centers - belongs, axis=1)))
    return errors

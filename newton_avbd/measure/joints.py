# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""How well the joints of a simulated state hold: open anchors, misaligned axes, passed limits.

Everything is worked out from body poses and the joints' frames, never from joint coordinates, so
that solvers in joint coordinates and in body coordinates are measured alike.
"""

import math
from dataclasses import dataclass

import newton
import numpy as np
from numpy.typing import NDArray

from newton_avbd.measure.state import Array
from newton_avbd.model.equalities import may_hold
from newton_avbd.model.rotations import conjugate, product, rotate, transform

_UNLIMITED = (newton.JointType.FREE, newton.JointType.DISTANCE, newton.JointType.ROD)
_LEAST = 1e-9
"""Energy that stands for none where it is divided by [J]."""

_PARALLEL = 0.2
"""Sine of the angle below which two axes count as nearly parallel."""

_SQUARE = 1e-4
"""Cosine between axes from which they are not square to each other."""


@dataclass(frozen=True)
class Joints:
    """The enabled joints of a model that hold something, n of them, read once.

    Free joints hold nothing and are left out, as are distance joints and rods, which hold no
    direction.

    Attributes:
        index: Each joint's index in the model, shape [n].
        parent: Body of each joint's parent, -1 for the world, shape [n].
        child: Body of each joint's child, shape [n].
        parent_frame: Pose of the anchor in the parent, shape [n, 7].
        child_frame: Pose of the anchor in the child, shape [n, 7].
        angular: Number of free angular axes, shape [n].
        locked: Projection of an offset between the anchors, in the parent's anchor frame, onto
            the directions that the joint locks, shape [n, 3, 3].
        slide: Maps such an offset to the linear coordinates, unused ones 0, shape [n, 3, 3].
        basis: Right-handed columns; a rotation is taken apart into turns about them, one after
            the other. With three free axes these, with two the locked one between them, with one
            that and two across; shape [n, 3, 3].
        sign: -1 where the last column is opposite to the joint's own axis, else 1, shape [n].
        lean: How far the second of two angular axes is from square to the first [rad], 0 for
            others, shape [n].
        hinges: Rows: the three angular axes of a joint in which they are not square to each other,
            which is a chain of hinges then; zero for others, shape [n, 3, 3].
        lower: Lower limits, three linear and three angular [m, rad], shape [n, 6].
        upper: Upper limits, likewise.
        armature: Inertia of rotors, likewise [kg, kg m^2].
        ball: Whether a joint turns about no axes of its own, shape [n].
    """

    index: NDArray[np.int64]
    parent: NDArray[np.int64]
    child: NDArray[np.int64]
    parent_frame: Array
    child_frame: Array
    angular: NDArray[np.int64]
    locked: Array
    slide: Array
    basis: Array
    sign: Array
    lean: Array
    hinges: Array
    lower: Array
    upper: Array
    armature: Array
    ball: NDArray[np.bool_]

    @classmethod
    def of(cls, model: newton.Model) -> "Joints":
        """Read the joints of ``model``."""
        kind = model.joint_type.numpy()
        is_watched = model.joint_enabled.numpy() & may_hold(model) & ~np.isin(kind, _UNLIMITED)
        chosen = np.flatnonzero(is_watched)
        count = len(chosen)
        slide, locked = np.zeros((count, 3, 3)), np.zeros((count, 3, 3))
        basis, sign = np.tile(np.eye(3), (count, 1, 1)), np.ones(count)
        hinges, lean = np.zeros((count, 3, 3)), np.zeros(count)
        lower, upper = np.full((count, 6), -np.inf), np.full((count, 6), np.inf)
        axes = model.joint_axis.numpy().astype(float)
        armature, rotors = np.zeros((count, 6)), model.joint_armature.numpy().astype(float)
        limits = (model.joint_limit_lower.numpy(), model.joint_limit_upper.numpy())
        starts, dims = model.joint_qd_start.numpy(), model.joint_dof_dim.numpy()[chosen]
        for row, joint in enumerate(chosen):
            (linear, angular), start = dims[row], starts[joint]
            along = axes[start : start + linear]
            slide[row, :linear] = np.linalg.pinv(along.T)
            locked[row] = np.eye(3) - along.T @ slide[row, :linear]
            for side, source in zip((lower, upper), limits, strict=True):
                side[row, :linear] = source[start : start + linear]
            places = [*range(linear), *((3, 5) if angular == 2 else range(3, 3 + angular))]
            armature[row, places] = rotors[start : start + linear + angular]
            if angular == 0 or kind[joint] == newton.JointType.BALL:
                continue
            about = axes[start + linear : start + linear + angular]
            basis[row], sign[row] = _basis(about)
            if angular == 2:
                lean[row] = np.arcsin(sign[row] * (about[0] @ about[1]))
            if angular == 3 and np.abs(about @ about.T - np.eye(3)).max() > _SQUARE:
                hinges[row] = about
            for i, place in enumerate((0, 2) if angular == 2 else range(angular)):
                low, high = (float(source[start + linear + i]) for source in limits)
                # A pose does not tell full turns apart, so that wider limits say nothing.
                if low >= -math.pi and high <= math.pi:
                    lower[row, 3 + place], upper[row, 3 + place] = low, high
        return cls(
            index=chosen.astype(np.int64),
            parent=model.joint_parent.numpy()[chosen].astype(np.int64),
            child=model.joint_child.numpy()[chosen].astype(np.int64),
            parent_frame=model.joint_X_p.numpy()[chosen].astype(float),
            child_frame=model.joint_X_c.numpy()[chosen].astype(float),
            angular=dims[:, 1].astype(np.int64),
            locked=locked,
            slide=slide,
            basis=basis,
            sign=sign,
            lean=lean,
            hinges=hinges,
            lower=lower,
            upper=upper,
            armature=armature,
            ball=kind[chosen] == newton.JointType.BALL,
        )

    def separation(self, body_q: Array) -> Array:
        """Distance between the two anchors along what each joint locks [m], shape [n].

        Args:
            body_q: Body poses, shape [bodies, 7].
        """
        offset, _ = self._relative(body_q)
        return np.linalg.norm(np.einsum("nij,nj->ni", self.locked, offset), axis=1)

    def misalignment(self, body_q: Array) -> Array:
        """Angle of the rotation about what each joint locks [rad], shape [n].

        A hinge is off by the angle between the axis in its parent and in its child; a joint with
        two free axes by the turn about the one across them; one with three by nothing.

        Args:
            body_q: Body poses, shape [bodies, 7].
        """
        _, turn = self._relative(body_q)
        whole = 2.0 * np.arctan2(np.linalg.norm(turn[:, :3], axis=1), np.abs(turn[:, 3]))
        axis = self.basis[:, :, 0]
        moved = rotate(turn, axis)
        across = np.linalg.norm(np.cross(axis, moved), axis=1)
        swing = np.arctan2(across, np.einsum("ni,ni->n", axis, moved))
        middle = np.abs(self._angles(turn)[:, 1] - self.lean)
        return np.choose(self.angular, (whole, swing, middle, np.zeros(len(turn))))

    def limit_violation(self, body_q: Array) -> Array:
        """How far each joint is past its limits [m for sliding, rad for turning], shape [n].

        Args:
            body_q: Body poses, shape [bodies, 7].
        """
        offset, turn = self._relative(body_q)
        angles = self._angles(turn)
        angles[:, 2] *= self.sign
        # About a single axis the whole range of angles can be told from the pose.
        twist = 2.0 * np.arctan2(
            np.einsum("ni,ni->n", turn[:, :3], self.basis[:, :, 0]), turn[:, 3]
        )
        wrapped = np.arctan2(np.sin(twist), np.cos(twist))
        angles[:, 0] = np.where(self.angular == 1, wrapped, angles[:, 0])
        slid = np.einsum("nij,nj->ni", self.slide, offset)
        # About three axes two triples of angles say the same; the joint may be at either.
        other = angles * [1.0, -1.0, 1.0] + np.pi
        other = np.arctan2(np.sin(other), np.cos(other))
        cosine = np.abs(np.cos(angles[:, 1]))[:, None]
        skew = self.hinges[:, 0].any(axis=1)
        if skew.any():
            angles[skew], other[skew], cosine[skew, 0] = self._hinged(turn)
        passed, beyond = self._passed(slid, angles), self._passed(slid, other)
        # Where the outer two are nearly parallel, what they turn against each other turns the
        # child by the cosine of the middle angle less. Their sum counts whole.
        is_near = (self.angular == 3) & (cosine[:, 0] < _PARALLEL)
        for triple in (passed, beyond):
            triple[:, [3, 5]] *= np.where(is_near[:, None], cosine, 1.0)
        nearest = np.minimum(passed.max(axis=1), beyond.max(axis=1))
        is_near &= ~skew
        nearest[is_near] = np.maximum(nearest, self._sum_passed(turn))[is_near]
        return np.where(self.angular == 3, nearest, passed.max(axis=1))

    def _sum_passed(self, turn: Array) -> Array:
        """How far the sum of the outer two of three angles is beyond what their limits allow.

        Of R = R_x(a) R_y(b) R_z(c), R_21 +- R_10 and R_11 -+ R_20 are (1 +- sin b) times the sine
        and the cosine of a +- c: they have all digits where a and c by themselves have none.
        """
        r = self._matrix(turn)
        up = np.where(r[:, 0, 2] < 0.0, -1.0, 1.0)
        side = up * self.sign
        last = np.sort(side[:, None] * np.stack([self.lower[:, 5], self.upper[:, 5]], 1), axis=1)
        lower, upper = self.lower[:, 3] + last[:, 0], self.upper[:, 3] + last[:, 1]
        total = np.arctan2(r[:, 2, 1] + up * r[:, 1, 0], r[:, 1, 1] - up * r[:, 2, 0])
        turns = total[:, None] + 2.0 * np.pi * np.arange(-2, 3)
        beyond = np.maximum(lower[:, None] - turns, turns - upper[:, None])
        return np.maximum(beyond, 0.0).min(axis=1)

    def rates(self, body_q: Array, body_qd: Array, com: Array) -> Array:
        """Rates of the linear and angular coordinates [m/s, rad/s], unused ones 0, shape [n, 6].

        NaN for a joint of three angular axes of which two are nearly parallel: what they turn
        against each other is not to be read off the bodies.

        Args:
            body_q: Body poses, shape [bodies, 7].
            body_qd: Velocities of centers of mass and angular ones, shape [bodies, 6].
            com: Centers of mass in the body frames [m], shape [bodies, 3].
        """
        poses = np.vstack([body_q, [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]])
        twists = np.vstack([body_qd, np.zeros(6)])
        centers = transform(poses, np.vstack([com, np.zeros(3)]))
        anchor = transform(poses[self.child], self.child_frame[:, :3])

        def at_anchor(body: NDArray[np.int64]) -> Array:
            return twists[body, :3] + np.cross(twists[body, 3:], anchor - centers[body])

        back = conjugate(product(poses[self.parent, 3:], self.parent_frame[:, 3:]))
        sliding = rotate(back, at_anchor(self.child) - at_anchor(self.parent))
        turning = rotate(back, twists[self.child, 3:] - twists[self.parent, 3:])
        _, turn = self._relative(body_q)
        angles = self._angles(turn)
        first, second = self.basis[:, :, 0], self.basis[:, :, 1]
        axes = np.zeros((len(turn), 3, 3))
        axes[:, :, 0] = first
        middle = product(_about(first, angles[:, 0]), _about(second, angles[:, 1]))
        axes[:, :, 1] = rotate(_about(first, angles[:, 0]), second)
        axes[:, :, 2] = rotate(middle, self.basis[:, :, 2] * self.sign[:, None])
        skew = self.hinges[:, 0].any(axis=1)
        if skew.any():
            a, b, c = (self.hinges[skew, i] for i in range(3))
            one, other, _ = self._hinged(turn)
            chosen = self._is_nearer(one, other)[:, None]
            first_two = np.where(chosen, one, other)
            outer, inner = _about(a, first_two[:, 0]), _about(b, first_two[:, 1])
            axes[skew] = np.stack([a, rotate(outer, b), rotate(product(outer, inner), c)], axis=2)
        axes[self.angular == 2, :, 1] = 0.0
        axes[self.angular == 1, :, 1:] = 0.0
        axes[self.angular == 0] = 0.0
        axes[self.ball] = np.eye(3)
        turned = np.einsum("nij,nj->ni", np.linalg.pinv(axes), turning)
        turned[(self.angular == 3) & ~self.ball & (np.abs(np.cos(angles[:, 1])) < _PARALLEL)] = (
            np.nan
        )
        return np.hstack([np.einsum("nij,nj->ni", self.slide, sliding), turned])

    def _passed(self, slid: Array, angles: Array) -> Array:
        """How far coordinates, shape [n, 3] each, are beyond limits, at least 0, shape [n, 6].

        Poses do not tell revolutions: an angle between two limits is past the nearer one.
        """
        at = np.hstack([slid, angles])
        passed = np.maximum(np.maximum(self.lower - at, at - self.upper), 0.0)
        between = np.isfinite(self.lower) & np.isfinite(self.upper)
        between[:, :3] = False
        lower, upper = self.lower[between], self.upper[between]
        above = np.mod(at[between] - lower, 2.0 * np.pi)
        passed[between] = np.minimum(np.maximum(above - (upper - lower), 0.0), 2.0 * np.pi - above)
        return passed

    def _relative(self, body_q: Array) -> tuple[Array, Array]:
        """Offset [m] and rotation of the child's anchor, both in the parent's anchor frame."""
        # Row -1 is the world.
        poses = np.vstack([body_q, [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]])
        parent, child = poses[self.parent], poses[self.child]
        back = conjugate(product(parent[:, 3:], self.parent_frame[:, 3:]))
        apart = transform(child, self.child_frame[:, :3]) - transform(
            parent, self.parent_frame[:, :3]
        )
        turn = product(back, product(child[:, 3:], self.child_frame[:, 3:]))
        return rotate(back, apart), turn

    def _hinged(self, turn: Array) -> tuple[Array, Array, Array]:
        """Both triples of angles [rad] of joints whose three axes a, b, c are not square, shape
        [skew joints, 3], and the sine between a and c.

        Of R = R_a R_b R_c, a . R c = a . R_b c has the middle angle; R c and R^T a have the others.
        """
        skew = self.hinges[:, 0].any(axis=1)
        a, b, c = (self.hinges[skew, i] for i in range(3))
        turn = turn[skew]
        end, begin = rotate(turn, c), rotate(conjugate(turn), a)
        both = _dot(a, b) * _dot(b, c)
        along, across = _dot(a, c) - both, _dot(a, np.cross(b, c))
        share = (_dot(a, end) - both) / np.hypot(along, across)
        triples = []
        for side in (1.0, -1.0):
            q = np.arctan2(across, along) + side * np.arccos(np.clip(share, -1.0, 1.0))
            u, v = rotate(_about(b, q), c), rotate(_about(b, -q), a)
            first = np.arctan2(_dot(a, np.cross(u, end)), _dot(u, end) - _dot(a, u) * _dot(a, end))
            last = np.arctan2(
                _dot(c, np.cross(begin, v)), _dot(v, begin) - _dot(c, v) * _dot(c, begin)
            )
            triples.append(np.stack([first, np.arctan2(np.sin(q), np.cos(q)), last], axis=1))
        return triples[0], triples[1], np.linalg.norm(np.cross(a, end), axis=1)

    def _is_nearer(self, one: Array, other: Array) -> NDArray[np.bool_]:
        """Whether skew joints are at ``one`` rather than at the ``other`` triple of angles: by how
        far these are beyond their limits, and then by how large they are, shape [skew joints]."""
        skew = self.hinges[:, 0].any(axis=1)
        lower, upper = self.lower[skew, 3:], self.upper[skew, 3:]

        def beyond(q: Array) -> Array:
            return np.asarray(np.maximum(np.maximum(lower - q, q - upper), 0.0).max(axis=1))

        less = beyond(one) - beyond(other)
        smaller = np.abs(one).sum(axis=1) <= np.abs(other).sum(axis=1)
        return np.asarray(np.where(less == 0.0, smaller, less < 0.0))

    def _matrix(self, turn: Array) -> Array:
        """Rotation matrices of ``turn`` in ``basis``, shape [n, 3, 3]."""
        moved = np.stack([rotate(turn, self.basis[:, :, i]) for i in range(3)], axis=2)
        return np.swapaxes(self.basis, 1, 2) @ moved

    def _angles(self, turn: Array) -> Array:
        """Angles of ``turn`` about the columns of ``basis`` in turn [rad], shape [n, 3].

        A second axis that leans is the last column turned about the one between.
        """
        r = self._matrix(product(turn, _about(self.basis[:, :, 1], self.lean)))
        return np.stack(
            [
                np.arctan2(-r[:, 1, 2], r[:, 2, 2]),
                np.arcsin(np.clip(r[:, 0, 2], -1.0, 1.0)),
                np.arctan2(-r[:, 0, 1], r[:, 0, 0]),
            ],
            axis=1,
        )


@dataclass
class JointQuality:
    """The worst that the joints of a run have shown in any state so far, and its energy.

    Attributes:
        separation: Largest distance between anchors along what a joint locks [m].
        misalignment: Largest rotation about what a joint locks [rad].
        limit: Largest violation of a limit [m or rad].
        energy: Energy of the bodies in the last state, without that of rotors [J].
        gain: Most energy above that of the first state, relative to that.
    """

    separation: float = 0.0
    misalignment: float = 0.0
    limit: float = 0.0
    energy: float = math.nan
    gain: float = 0.0


class JointProbe:
    """Watches the joints of one model over a run."""

    def __init__(self, model: newton.Model):
        self._joints = Joints.of(model)
        self._start: float | None = None
        self.worst = JointQuality()

    @property
    def watching(self) -> bool:
        """Whether there is anything to watch."""
        return len(self._joints.child) > 0

    def watch(self, body_q: Array, energy: float) -> None:
        """Take a state in.

        Args:
            body_q: Body poses, shape [bodies, 7].
            energy: Energy of the bodies [J].
        """
        self._start = energy if self._start is None else self._start
        worst, joints = self.worst, self._joints
        worst.separation = _worse(worst.separation, joints.separation(body_q))
        worst.misalignment = _worse(worst.misalignment, joints.misalignment(body_q))
        worst.limit = _worse(worst.limit, joints.limit_violation(body_q))
        worst.energy = energy
        gain = (energy - self._start) / max(abs(self._start), _LEAST)
        worst.gain = _worse(worst.gain, np.array([gain]))


def _basis(axes: Array) -> tuple[Array, float]:
    """Right-handed columns to take a rotation apart about, and the sign of the last one.

    Args:
        axes: Free angular axes of a joint, shape [1 to 3, 3].
    """
    first = axes[0]
    if len(axes) == 1:
        second = np.linalg.svd(first[None])[2][1]
    else:
        second = np.cross(first, axes[1]) if len(axes) == 2 else axes[1]
        second = second / np.linalg.norm(second)
    third = np.cross(first, second)
    sign = 1.0 if len(axes) == 1 or third @ axes[-1] > 0.0 else -1.0
    return np.stack([first, second, third], axis=1), sign


def _dot(a: Array, b: Array) -> Array:
    """Products of vectors, shape [n]."""
    return np.asarray(np.sum(a * b, axis=1))


def _about(axis: Array, angle: Array) -> Array:
    """Quaternions of turns about unit axes, shape [n, 4]."""
    return np.hstack([np.sin(0.5 * angle)[:, None] * axis, np.cos(0.5 * angle)[:, None]])


def _worse(so_far: float, values: Array) -> float:
    """The larger; NaN where one is, so that a failed run cannot look good."""
    return float(np.max(values, initial=so_far))

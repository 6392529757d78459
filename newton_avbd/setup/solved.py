# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""The model as the solver solves it, where that is not the user's model as it stands."""

from dataclasses import dataclass
from typing import Any

import newton
import numpy as np
import warp as wp

from .. import data
from ..attributes import dahl_friction
from ..drivers.launch import Launcher
from ..model.tokens import token_masses
from ..model.welds import IDENTITY, Welds, multiply
from ..rows.joint import PUSHED_AT_COM
from ..step.links import gather_joints, weigh_bodies
from .joined import JoinedModel
from .views import indices


def solved_model(joined: JoinedModel, welds: Welds) -> "SolvedModel | None":
    """What the solver solves instead of the user's model; None where that is the model itself.

    Args:
        joined: The user's model with the joints that it lacks.
        welds: What welds make of that.
    """
    has_own_joints = _has_own_joints(joined, welds)
    is_led = joined.body_flags.numpy() & int(newton.BodyFlags.KINEMATIC) != 0
    if not has_own_joints and np.all((joined.body_mass.numpy() > 0.0) | is_led):
        return None
    solved = SolvedModel(joined, welds)
    return solved if has_own_joints or solved.has_tokens else None


def _has_own_joints(joined: JoinedModel, welds: Welds) -> bool:
    """Whether the joints solved are other than the user's model's."""
    return welds.any or joined.own_rows.size > 0


@dataclass(frozen=True)
class BodyState:
    """What of a :class:`newton.State` the solver reads and writes, of its bodies."""

    body_q: wp.array
    body_qd: wp.array
    body_f: wp.array


class SolvedModel:
    """A model whose bodies are what welds make of links, and whose massless links have tokens.

    Its joints are those of a :class:`.joined.JoinedModel` that are no welds. It has the arrays of a
    :class:`newton.Model` that the solver reads: those of bodies and joints are its own, all else is
    the user's model's.
    """

    def __init__(self, joined: JoinedModel, welds: Welds) -> None:
        """Makes the arrays.

        Raises:
            ValueError: If a body has no mass that its joints call for; see :mod:`.model.tokens`.
        """
        self._joined = joined
        self._model = model = joined.whole
        self.welds = welds
        self.body_count, self.body_leader = welds.leader.size, welds.leader
        self.body_of_link = welds.body
        self._own = np.flatnonzero(welds.joint >= joined.model.joint_count)
        """Joints that the user's model lacks, and which no weld has taken."""
        self._has_own_joints = _has_own_joints(joined, welds)
        with wp.ScopedDevice(model.device):
            self._make_bodies()
            if self._has_own_joints:
                self._make_joints()
            self._make_links()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._model, name)

    @property
    def user_model(self) -> newton.Model:
        """The model that this one stands for, with the joints that it lacks."""
        return self._model

    @property
    def weld_indices(self) -> np.ndarray:
        """The welds, as indices of :attr:`weld_label`."""
        return np.arange(self.welds.welded.size)

    @property
    def weld_label(self) -> list[str]:
        """Labels of the joints that are welds."""
        return [self._model.joint_label[joint] for joint in self.welds.welded]

    def _make_bodies(self) -> None:
        model, leader = self._model, self.body_leader
        self.body_label = [model.body_label[link] for link in leader]
        self.body_world = _taken(model.body_world, leader)
        self.body_q, self.body_qd = _taken(model.body_q, leader), _taken(model.body_qd, leader)
        self.body_flags = _taken(model.body_flags, leader)
        self.body_mass = wp.zeros(self.body_count, dtype=float)
        self.body_inv_mass = wp.zeros(self.body_count, dtype=float)
        self.body_com = wp.zeros(self.body_count, dtype=wp.vec3)
        self.body_inertia = wp.zeros(self.body_count, dtype=wp.mat33)
        self.body_inv_inertia = wp.zeros(self.body_count, dtype=wp.mat33)
        self._bodies = data.BodyModel()
        for name in ("mass", "inertia", "inv_mass", "inv_inertia", "com", "flags"):
            setattr(self._bodies, name, getattr(self, f"body_{name}"))

    def _make_joints(self) -> None:
        model, welds = self._model, self.welds
        kept = welds.joint
        body = np.append(welds.body, -1)
        self.joint_count = kept.size
        self.joint_label = [model.joint_label[joint] for joint in kept]
        self.joint_child = indices(body[model.joint_child.numpy()[kept]])
        self.joint_parent = indices(body[model.joint_parent.numpy()[kept]])
        for name in ("type", "X_p", "X_c", "enabled", "dof_dim", "mimic_coeffs", "mimic_joint"):
            setattr(self, f"joint_{name}", _taken(getattr(model, f"joint_{name}"), kept))
        for name in ("q_start", "qd_start"):
            # welds have no coordinates: what is left starts where it did
            starts = getattr(model, f"joint_{name}").numpy()
            setattr(self, f"joint_{name}", indices(starts[np.append(kept, model.joint_count)]))
        if model.constraint_mimic_count:
            for name in ("joint0", "joint1"):
                ends = getattr(model, f"constraint_mimic_{name}")
                setattr(self, f"constraint_mimic_{name}", wp.empty_like(ends))
        authored = getattr(model, "avbd", None)
        if authored is not None:
            self.avbd = _Kept(authored, kept)
        if dahl_friction(model):
            self.vbd = _Kept(model.vbd, kept)
        if welds.any and model.shape_count:
            shape_link = model.shape_body.numpy()
            self.shape_body = indices(body[shape_link])
            frame = np.vstack([welds.frame, IDENTITY])
            self.shape_frame = wp.array(frame[shape_link].astype(np.float32), dtype=wp.transform)

    def _make_links(self) -> None:
        """Finds the links of each body, and what pushes it elsewhere than at its COM."""
        model, welds, count = self._model, self.welds, self.body_count
        links = self.links = data.LinkModel()
        member = np.flatnonzero(welds.body >= 0)
        member = member[np.argsort(welds.body[member], kind="stable")]
        size = np.bincount(welds.body[member], minlength=count)
        data.fill(links, body=welds.body, frame=welds.frame, leader=welds.leader, joint=welds.joint)
        data.fill(links, members=np.append(member, np.flatnonzero(welds.body < 0)))
        data.fill(links, member_start=np.append(0, np.cumsum(size)))
        data.allocate(links, welds.body.size, "arm", "known_mass", "known_com", "known_inertia")
        if model.joint_count:
            links.enabled = self.joint_enabled
        if self._has_own_joints:
            links.parent_frame, links.child_frame = self.joint_X_p, self.joint_X_c
        states = ("body_q", "body_qd", "body_f", "body_q_out", "body_qd_out")
        data.allocate(links, count if welds.any else 0, *states)
        data.allocate(links, welds.body.size if welds.any else 0, "left_qd")
        self.given = BodyState(links.body_q, links.body_qd, links.body_f)
        self.result = BodyState(links.body_q_out, links.body_qd_out, links.body_f)
        pushes: list[list[tuple[int, int, float]]] = [[] for _ in range(count)]
        if welds.any:
            kinds = self.joint_type.numpy()
            child, parent = self.joint_child.numpy(), self.joint_parent.numpy()
            for joint in np.flatnonzero(np.isin(kinds, [int(kind) for kind in PUSHED_AT_COM])):
                link = model.joint_child.numpy()[welds.joint[joint]]
                if size[child[joint]] > 1:
                    pushes[child[joint]].append((joint, link, 1.0))
                    if parent[joint] >= 0:
                        pushes[parent[joint]].append((joint, link, -1.0))
        flat = [item for items in pushes for item in items]
        joints = [joint for joint, _, _ in flat]
        data.fill(links, push_joint=joints, pushed=[link for _, link, _ in flat])
        data.fill(links, push_sign=[sign for _, _, sign in flat])
        data.fill(links, push_start=np.cumsum([0, *map(len, pushes)]))
        dof = self.joint_qd_start.numpy() if model.joint_count else np.zeros(1)
        data.fill(links, push_dof=dof[joints])
        data.allocate(links, count, "token_mass", "token_moment", "is_free")
        self.reread()

    def reread(self) -> None:
        """Reads again what only the host knows: mimics, joints of rows, and massless links.

        Raises:
            ValueError: If a body has no mass that its joints call for; see :mod:`.model.tokens`.
        """
        model, welds = self._model, self.welds
        if self._has_own_joints:
            self._place_own_joints()
            number = np.full(model.joint_count + 1, -1)
            number[welds.joint] = np.arange(welds.joint.size)
            self.joint_mimic_joint.assign(number[model.joint_mimic_joint.numpy()[welds.joint]])
            self.joint_mimic_coeffs.assign(model.joint_mimic_coeffs.numpy()[welds.joint])
            if model.constraint_mimic_count:
                for name in ("joint0", "joint1"):
                    ends = getattr(model, f"constraint_mimic_{name}").numpy()
                    getattr(self, f"constraint_mimic_{name}").assign(number[ends])
        self.body_flags.assign(model.body_flags.numpy()[self.body_leader])
        mass = self._masses()
        self._is_massless = mass == 0.0
        token_mass, token_moment, is_free = token_masses(model, self, mass)
        self.has_tokens = bool(np.any(token_mass > 0.0))
        self.links.token_mass.assign(token_mass)
        self.links.token_moment.assign(token_moment)
        self.links.is_free.assign(is_free & ~welds.is_static[welds.leader])

    def _place_own_joints(self) -> None:
        """Types of the joints that the user's model lacks, and their anchor frames on bodies."""
        model, own = self._model, self._own
        joints = self.welds.joint[own]
        frame = np.vstack([self.welds.frame, IDENTITY])
        placed: dict[str, np.ndarray] = {"type": model.joint_type.numpy()[joints]}
        for name, link in (("X_p", model.joint_parent), ("X_c", model.joint_child)):
            frames = getattr(model, f"joint_{name}").numpy()[joints].astype(np.float64)
            placed[name] = multiply(frame[link.numpy()[joints]], frames)
        for name, values in placed.items():
            array = getattr(self, f"joint_{name}")
            whole = array.numpy().copy()
            whole[own] = values
            array.assign(whole)

    def _masses(self) -> np.ndarray:
        """Mass of each body without its token [kg]."""
        member = np.flatnonzero(self.welds.body >= 0)
        mass = self._model.body_mass.numpy()[member]
        return np.bincount(self.welds.body[member], mass, self.body_count)

    def has_other_masses(self) -> bool:
        """Whether other bodies are without mass than when the model was read, on the host."""
        return not np.array_equal(self._masses() == 0.0, self._is_massless)

    def weighed(self) -> Any:
        """This model with the masses that the next step finds, on the host; nothing is written.

        Of the massless links that there are so far; see :meth:`has_other_masses`.
        """
        model, leader = self._model, self.body_leader
        member = np.flatnonzero(self.welds.body >= 0)
        body, frame = self.welds.body[member], self.welds.frame[member]
        mass, com, inertia = (
            getattr(model, f"body_{name}").numpy().astype(np.float64)[member]
            for name in ("mass", "com", "inertia")
        )
        upright = np.tile([0.0, 0.0, 0.0, 1.0], (member.size, 1))
        at = multiply(frame, np.hstack([com, upright]))[:, :3]
        total = self._masses()
        center = np.zeros((self.body_count, 3))
        np.add.at(center, body, mass[:, None] * at)
        has_mass = total > 0.0
        center[has_mass] /= total[has_mass, None]
        center[~has_mass] = model.body_com.numpy()[leader[~has_mass]]
        spin = np.hstack([np.zeros((member.size, 3)), frame[:, 3:]])
        columns = [np.hstack([np.tile(axis, (member.size, 1)), upright]) for axis in np.eye(3)]
        turn = np.stack([multiply(spin, column)[:, :3] for column in columns], axis=2)
        arm = at - center[body]
        spread = np.sum(arm**2, axis=1)[:, None, None] * np.eye(3) - arm[:, :, None] * arm[:, None]
        tensor = np.zeros((self.body_count, 3, 3))
        parts = turn @ inertia @ turn.transpose(0, 2, 1) + mass[:, None, None] * spread
        np.add.at(tensor, body, parts)
        token_mass = self.links.token_mass.numpy()
        is_token = (token_mass > 0.0) & (total == 0.0)
        tensor[is_token] = self.links.token_moment.numpy()[is_token, None, None] * np.eye(3)
        total[is_token] = token_mass[is_token]
        is_one = (np.bincount(body, minlength=self.body_count) == 1) & ~is_token
        inverse = np.where(is_one, model.body_inv_mass.numpy()[leader], total > 0.0)
        return _Replaced(
            self,
            body_flags=model.body_flags.numpy()[leader],
            body_mass=total.astype(np.float32),
            body_com=center.astype(np.float32),
            body_inertia=tensor.astype(np.float32),
            body_inv_mass=inverse * self.links.is_free.numpy(),
        )

    def refresh(self, launch: Launcher) -> None:
        """Points to the model's arrays, and reads what each step reads again, on the device."""
        model, links = self._joined.model, self.links
        for name in ("com", "mass", "inertia", "inv_mass", "inv_inertia", "flags"):
            setattr(links, name, getattr(model, f"body_{name}"))
        if model.joint_count:
            links.enabled_in = model.joint_enabled
        if model.joint_count and self._has_own_joints:
            links.joint_parent, links.joint_child = model.joint_parent, model.joint_child
            links.parent_frame_in, links.child_frame_in = model.joint_X_p, model.joint_X_c
        launch.forget()
        self.weigh(launch, is_new=True)
        self.follow_joints(launch)

    def follow_joints(self, launch: Launcher) -> None:
        """Reads joints of the model again, where those solved are not its own, on the device."""
        if self._has_own_joints:
            launch(gather_joints, self.joint_count, [self.links])

    def weigh(self, launch: Launcher, *, is_new: bool = False) -> None:
        """Reads masses and flags of the model again, on the device.

        Args:
            launch: Launches kernels.
            is_new: Whether tokens may have changed, or what may move.
        """
        launch(weigh_bodies, self.body_count, [is_new, self.links, self._bodies])

    def loads(self) -> data.LinkLoads:
        """Buffers for what welds carry."""
        welds, loads = self.welds, data.LinkLoads()
        tied = np.flatnonzero(welds.weld >= 0)
        with wp.ScopedDevice(self._model.device):
            loads.link = wp.zeros(welds.body.size, dtype=wp.spatial_vector)
            data.fill(loads, order=tied[np.argsort(-welds.depth[tied], kind="stable")])
            data.fill(loads, towards=welds.towards, weld=welds.weld)
        return loads


class _Replaced:
    """A model with some arrays in the place of its own, for who reads them by ``numpy()``."""

    def __init__(self, model: Any, **arrays: np.ndarray) -> None:
        self._model = model
        self._arrays = {name: _OnHost(values) for name, values in arrays.items()}

    def __getattr__(self, name: str) -> Any:
        return self._arrays[name] if name in self._arrays else getattr(self._model, name)


@dataclass(frozen=True)
class _OnHost:
    """An array that is read as one on a device is."""

    values: np.ndarray

    def numpy(self) -> np.ndarray:
        """Its values."""
        return self.values


class _Kept:
    """Attributes of a scene, those of joints without the welds."""

    def __init__(self, authored: Any, kept: np.ndarray) -> None:
        self._authored, self._kept = authored, kept

    def __getattr__(self, name: str) -> Any:
        value = getattr(self._authored, name)
        return _taken(value, self._kept) if name.startswith(("joint_", "dahl_")) else value


def _taken(array: wp.array, items: np.ndarray) -> wp.array:
    """Some items of an array, in an array of its own."""
    return wp.array(array.numpy()[items], dtype=array.dtype)

# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""MuJoCo's actuators and gravity compensation of a model, from its ``mujoco`` namespace.

Actuators whose control is ``control.mujoco.ctrl`` act here. An actuator that an importer made a
joint drive of (``JOINT_TARGET``) is that drive, unless it authors more than gains: a range,
armature or damping of its own, or a damping ratio. Then the drive is an actuator. Their arrays are
in :mod:`.setup.actuation`, what a step does with them is in :mod:`.step.actuation`, the formulas
are in :mod:`.rows.actuator`.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import newton
import numpy as np
from newton.solvers import SolverMuJoCo

from ..rows import actuator as rules
from ..rows.joint import KINDS, NO_LIMIT
from .tendons import tendon_count, tendons

_TRANSMISSION = SolverMuJoCo.TrnType
_PUSHING = (
    *(_TRANSMISSION.JOINT, _TRANSMISSION.JOINT_IN_PARENT, _TRANSMISSION.SLIDERCRANK),
    *(_TRANSMISSION.TENDON, _TRANSMISSION.SITE, _TRANSMISSION.BODY),
)
"""Transmissions that push something here."""
_CTRL_DIRECT = int(SolverMuJoCo.CtrlSource.CTRL_DIRECT)
"""An actuator with an input of its own, not the target of a joint."""
_JOINT_TARGET = int(SolverMuJoCo.CtrlSource.JOINT_TARGET)
_POSITION, _VELOCITY = int(SolverMuJoCo.CtrlType.POSITION), int(SolverMuJoCo.CtrlType.VELOCITY)
_DRIVES = {
    int(newton.JointTargetMode.POSITION): (rules.POSITION_TARGET,),
    int(newton.JointTargetMode.VELOCITY): (rules.VELOCITY_TARGET,),
    int(newton.JointTargetMode.POSITION_VELOCITY): (
        rules.UNDAMPED_POSITION_TARGET,
        rules.VELOCITY_TARGET,
    ),
}
"""The actuators that SolverMuJoCo makes of a drive, by its mode."""
_BALL, _FREE = int(newton.JointType.BALL), int(newton.JointType.FREE)
ACTING = (
    *("actuators", "tendons", "body_actuators", "servos", "adhesion", "gravity_compensation"),
)
"""Effects of what acts before a step."""
_AUTO = 2
"""A limit that holds where a range is given."""
_IDENTITY = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
_DYNAMICS = (0, 1, 2, 3, 4, 5)
"""Dynamics of activation that :mod:`.rows.actuator` knows."""
_LAWS = (0, 1, 2, 3)
"""Gains and biases that it knows."""
_AFFINE = int(rules.AFFINE_GAIN)
"""Of the length and the velocity; gains and biases with greater numbers are curves of these."""


def authored(model: newton.Model, name: str) -> np.ndarray | None:
    """Values of an attribute of the ``mujoco`` namespace, None where the model has none."""
    array = getattr(getattr(model, "mujoco", None), name, None)
    return None if array is None else array.numpy()


def compensated_links(model: newton.Model) -> np.ndarray:
    """Links whose weight is compensated, as a whole or in part."""
    share = authored(model, "gravcomp")
    return np.zeros(0, dtype=int) if share is None else np.flatnonzero(share)


@dataclass(frozen=True)
class DriveActuator:
    """An actuator that is a joint drive, or one of the two of a POSITION_VELOCITY drive."""

    row: int
    """Row that it takes ranges, armature and damping from; -1 for none."""
    dof: int
    kind: int
    """What it takes from the drive; see :mod:`.rows.actuator`."""


@dataclass
class Actuators:
    """What each of a model's actuators pushes, by row of its ``mujoco:actuator`` attributes."""

    labels: list[str] = field(default_factory=list)
    axes: dict[int, int] = field(default_factory=dict)
    """Degree of freedom of those that push along a joint axis."""
    drives: list[DriveActuator] = field(default_factory=list)
    """Those that stand in the place of joint drives."""
    bodies: dict[int, tuple[int, int, Any, int, Any]] = field(default_factory=dict)
    """Of those that push bodies: whose axes the gear is in, the link with a frame on it, and the
    link that gets the reaction with a frame on it."""
    tendons: dict[int, int] = field(default_factory=dict)
    """Tendon of those that pull one."""
    adhesive: dict[int, int] = field(default_factory=dict)
    """Link of those that pull one towards what it touches."""
    left: dict[int, str] = field(default_factory=dict)
    """Why those do nothing that do nothing."""

    @classmethod
    def of_model(cls, model: newton.Model) -> "Actuators":
        """Finds what each actuator acts on; copies model arrays to the host.

        Raises:
            ValueError: If an actuator has a transmission or a target that there is not, or a crank
                no length.
        """
        found = cls()
        if not model.custom_frequency_counts.get("mujoco:actuator", 0):
            return found
        found.labels = list(model.mujoco.actuator_label)
        cords = {tendon.row for tendon in tendons(model)}
        kinds = model.mujoco.actuator_trntype.numpy()
        for row in np.flatnonzero(model.mujoco.ctrl_source.numpy() == _CTRL_DIRECT).tolist():
            why = _unknown_law(model, row)
            if why:
                found.left[row] = why
                continue
            if kinds[row] not in set(_TRANSMISSION):
                names = ", ".join(f"{kind.value} ({kind.name})" for kind in _PUSHING)
                raise ValueError(
                    f"model.mujoco.actuator_trntype[{row}] ('{found.labels[row]}') is "
                    f"{kinds[row]}, no transmission of MuJoCo's. Set one of {names}."
                )
            kind, target = _target(model, row, int(kinds[row]))
            if kind in (_TRANSMISSION.JOINT, _TRANSMISSION.JOINT_IN_PARENT) and target >= 0:
                found._add_joint(model, row, target, kind == _TRANSMISSION.JOINT_IN_PARENT)
            elif kind == _TRANSMISSION.SITE and target >= 0:
                found._add_site(model, row, target)
            elif kind == _TRANSMISSION.SLIDERCRANK and target >= 0:
                found._add_crank(model, row, target)
            elif kind == _TRANSMISSION.TENDON and target >= 0:
                if target in cords:
                    found.tendons[row] = target
                else:
                    found.left[row] = "the tendon that it pulls does not act"
            elif kind == _TRANSMISSION.BODY and target >= 0:
                found.adhesive[row] = target
            elif target < 0:
                found.left[row] = "its target does not exist"
            else:
                found.left[row] = f"its transmission is {_TRANSMISSION(kind).name}"
        found._add_drives(model)
        return found

    def driven(self) -> list[int]:
        """Degrees of freedom whose drives are actuators."""
        return [drive.dof for drive in self.drives]

    def armature(self, model: newton.Model) -> np.ndarray:
        """What actuators add to the armature of degrees of freedom [kg or kg m^2]."""
        added = reflected_armature(model, self.axes, model.joint_dof_count)
        pairs = [(drive.dof, drive.row) for drive in self.drives if drive.row >= 0]
        if pairs:
            dofs, rows = np.array(pairs).T
            np.add.at(added, dofs, model.mujoco.actuator_armature.numpy()[rows])
        return added

    def servos(self, model: newton.Model) -> dict[int, int]:
        """Link of each actuator that pushes a body against the world, by how the body moves."""
        if not self.bodies:
            return {}
        by_motion = depends_on_motion(model.mujoco)
        return {
            row: link
            for row, (_, link, _, against, _) in self.bodies.items()
            if against < 0 and by_motion[row]
        }

    def is_shared(self, model: newton.Model) -> np.ndarray:
        """Degrees of freedom with several actuators, at least one of which has a force range, or
        all of them a limit besides."""
        counts = np.zeros(model.joint_dof_count, dtype=int)
        limited = np.zeros(model.joint_dof_count, dtype=int)
        np.add.at(counts, np.array([*self.axes.values(), *self.driven()], dtype=int), 1)
        np.add.at(limited, np.array(self.limited_axes(model), dtype=int), 1)
        has_effort = model.joint_effort_limit.numpy() < NO_LIMIT
        return (limited > 1) | ((counts > 1) & (limited == 1) & has_effort)

    def limited_axes(self, model: newton.Model) -> list[int]:
        """Degree of freedom of each actuator whose force has a range."""
        if not (self.axes or self.drives):
            return []
        limited = is_limited(model.mujoco, "force")
        pushing = [*self.axes.items(), *((drive.row, drive.dof) for drive in self.drives)]
        return [dof for row, dof in pushing if row >= 0 and limited[row]]

    def _add_drives(self, model: newton.Model) -> None:
        """Finds the drives that a row authors more of than gains, as SolverMuJoCo does.

        It makes a position actuator, a velocity actuator or both of a drive, each with what the
        last row for it authors. The gear of such rows is 1.
        """
        source, target = _rows_of_drives(model)
        if source.size == 0:
            return
        joint = np.searchsorted(model.joint_qd_start.numpy(), target, side="right") - 1
        kinds = model.joint_type.numpy()[joint]
        modes = model.joint_target_mode.numpy()
        types = model.mujoco.ctrl_type.numpy()
        taken = set(target[_authors_more(model, source, target)].tolist())
        last: dict[tuple[int, bool], int] = {}
        for row, dof, kind in zip(source.tolist(), target.tolist(), kinds.tolist(), strict=True):
            if dof not in taken:
                continue
            if kind == _BALL:
                self.left[row] = (
                    "the drive of its BALL joint has its gains, and no range or damping beside "
                    "(import it with ctrl_direct=True)"
                )
            if not KINDS[newton.JointType(kind)].has_axes:
                continue
            for is_position, other in ((True, _VELOCITY), (False, _POSITION)):
                if types[row] != other:
                    last[dof, is_position] = row
        for dof in sorted({dof for dof, _ in last}):
            for kind in _DRIVES.get(int(modes[dof]), ()):
                row = last.get((dof, kind != rules.VELOCITY_TARGET), -1)
                self.drives.append(DriveActuator(row, dof, int(kind)))

    def _add_joint(self, model: newton.Model, row: int, dof: int, in_parent: bool) -> None:
        joint = int(np.searchsorted(model.joint_qd_start.numpy(), dof, side="right")) - 1
        kind = int(model.joint_type.numpy()[joint])
        if KINDS[newton.JointType(kind)].has_axes:
            self.axes[row] = dof
            return
        child, parent = (
            int(getattr(model, f"joint_{end}").numpy()[joint]) for end in ("child", "parent")
        )
        if kind == _BALL:
            axes = rules.BALL_JOINT_IN_PARENT if in_parent else rules.BALL_JOINT
            frames = model.joint_X_c.numpy()[joint], model.joint_X_p.numpy()[joint]
            self.bodies[row] = (int(axes), child, frames[0], parent, frames[1])
        elif kind == _FREE:
            axes = rules.FREE_JOINT_IN_PARENT if in_parent else rules.FREE_JOINT
            self.bodies[row] = (int(axes), child, _IDENTITY, parent, _IDENTITY)
        else:
            self.left[row] = f"its joint is of type {newton.JointType(kind).name}"

    def _add_crank(self, model: newton.Model, row: int, site: int) -> None:
        frames, links = model.shape_transform.numpy(), model.shape_body.numpy()
        other = int(model.mujoco.actuator_trnid.numpy()[row, 1])
        if other < 0:
            self.left[row] = "the site of its slider does not exist"
            return
        _check_site(model, row, other)
        length = float(model.mujoco.actuator_cranklength.numpy()[row])
        if not length > 0.0:
            raise ValueError(
                f"model.mujoco.actuator_cranklength[{row}] ('{self.labels[row]}') must be above "
                f"zero, the length of the crank: {length}."
            )
        if links[site] >= 0:
            ends, axes = (site, other), rules.SLIDER_CRANK
        elif links[other] >= 0:
            ends, axes = (other, site), rules.CRANK_ON_WORLD
        else:
            self.left[row] = "neither of its sites moves"
            return
        self.bodies[row] = (
            *(int(axes), int(links[ends[0]]), frames[ends[0]]),
            *(int(links[ends[1]]), frames[ends[1]]),
        )

    def _add_site(self, model: newton.Model, row: int, site: int) -> None:
        frames, links = model.shape_transform.numpy(), model.shape_body.numpy()
        other = int(model.mujoco.actuator_trnid.numpy()[row, 1])
        _check_site(model, row, other)
        if links[site] < 0:
            self.left[row] = "its site does not move"
        elif other < 0:
            axes = int(rules.AT_SITE)
            self.bodies[row] = (axes, int(links[site]), frames[site], -1, _IDENTITY)
        else:
            axes = int(rules.AGAINST_SITE)
            self.bodies[row] = (
                *(axes, int(links[site]), frames[site]),
                *(int(links[other]), frames[other]),
            )


def _rows_of_drives(model: newton.Model) -> tuple[np.ndarray, np.ndarray]:
    """Rows of actuators that are joint drives, and the degree of freedom of each."""
    mujoco: Any = model.mujoco
    is_drive = mujoco.ctrl_source.numpy() == _JOINT_TARGET
    is_drive &= mujoco.actuator_trntype.numpy() == int(_TRANSMISSION.JOINT)
    target = mujoco.actuator_trnid.numpy()[:, 0]
    rows = np.flatnonzero(is_drive & (target >= 0) & (target < model.joint_dof_count))
    return rows, target[rows]


def _authors_more(model: newton.Model, rows: np.ndarray, dofs: np.ndarray) -> np.ndarray:
    """Which of some rows that are drives author more than gains, for a drive that there is."""
    mujoco: Any = model.mujoco
    modes, types = model.joint_target_mode.numpy()[dofs], mujoco.ctrl_type.numpy()[rows]
    more = is_limited(mujoco, "ctrl")[rows] | is_limited(mujoco, "force")[rows]
    for name in ("damping", "dampingpoly", "armature"):
        values = getattr(mujoco, f"actuator_{name}").numpy()[rows]
        more |= np.any(values.reshape(rows.size, -1) != 0.0, axis=1)
    more |= has_damping_ratio(model, rows, dofs)
    feeds = np.zeros(rows.size, dtype=bool)
    for mode, kinds in _DRIVES.items():
        for kind in kinds:
            other = _POSITION if kind == rules.VELOCITY_TARGET else _VELOCITY
            feeds |= (modes == mode) & (types != other)
    return more & feeds


def has_damping_ratio(model: newton.Model, rows: np.ndarray, dofs: np.ndarray) -> np.ndarray:
    """Which of some rows that are drives say how much their drives damp.

    As for SolverMuJoCo, a ``biasprm[2]`` above zero is a ratio where ``joint_target_kd`` is zero.
    """
    is_ratio = model.mujoco.actuator_biasprm.numpy()[rows, 2] > 0.0
    is_ratio &= model.joint_target_mode.numpy()[dofs] == int(newton.JointTargetMode.POSITION)
    is_ratio &= model.mujoco.ctrl_type.numpy()[rows] != _VELOCITY
    return is_ratio & (model.joint_target_kd.numpy()[dofs] == 0.0)


def _unknown_law(model: newton.Model, row: int) -> str:
    """Why the solver does not know what an actuator does; empty where it does."""
    mujoco: Any = model.mujoco
    for name, what, known in (
        ("dyn", "dynamics", _DYNAMICS),
        ("gain", "gain", _LAWS),
        ("bias", "bias", _LAWS),
    ):
        kind = int(getattr(mujoco, f"actuator_{name}type").numpy()[row])
        if kind not in known:
            return f"its {what} ({name}type {kind}) is a PID's, SO3's, the user's, or unknown"
    return ""


def _target(model: newton.Model, row: int, kind: int) -> tuple[int, int]:
    """Transmission of an actuator and the index of its target, -1 where there is none.

    Importers of USD may leave the target's label only, as SolverMuJoCo expects it.

    Raises:
        ValueError: There are not as many targets.
    """
    mujoco: Any = model.mujoco
    first, second = mujoco.actuator_trnid.numpy()[row].tolist()
    label = mujoco.actuator_target_label[row]
    if kind == _TRANSMISSION.TENDON and (first < 0 or (first == 0 and second > 0)):
        first = second
    if kind == _TRANSMISSION.SITE and label in model.shape_label:
        first = model.shape_label.index(label)
    elif first < 0 and label:
        named = {
            _TRANSMISSION.JOINT: getattr(mujoco, "joint_dof_label", ()),
            _TRANSMISSION.TENDON: getattr(mujoco, "tendon_label", ()),
            _TRANSMISSION.SITE: model.shape_label,
        }
        for known, labels in named.items():
            if label in labels:
                return known, list(labels).index(label)
    what, count = {
        _TRANSMISSION.JOINT: ("degrees of freedom", model.joint_dof_count),
        _TRANSMISSION.JOINT_IN_PARENT: ("degrees of freedom", model.joint_dof_count),
        _TRANSMISSION.TENDON: ("tendons", tendon_count(model)),
        _TRANSMISSION.SITE: ("shapes", model.shape_count),
        _TRANSMISSION.SLIDERCRANK: ("shapes", model.shape_count),
        _TRANSMISSION.BODY: ("bodies", model.body_count),
    }.get(_TRANSMISSION(kind), ("", first + 1))
    _check_target(model, row, first, count, what)
    return kind, first


def _check_site(model: newton.Model, row: int, site: int) -> None:
    """Refuses a second site, of an actuator, that there is not."""
    _check_target(model, row, site, model.shape_count, "shapes")


def _check_target(model: newton.Model, row: int, target: int, count: int, what: str) -> None:
    """Refuses a target of an actuator past the last one of its kind; -1 is none."""
    if target >= count:
        raise ValueError(
            f"model.mujoco.actuator_trnid[{row}] ('{model.mujoco.actuator_label[row]}') names "
            f"target {target}, and the model has {count} {what}. Set an index below that, or -1 "
            "to leave the actuator out."
        )


def is_limited(mujoco: Any, name: str) -> np.ndarray:
    """Which actuators clamp their control, force or activation; MuJoCo's ``autolimits``."""
    limited = getattr(mujoco, f"actuator_{name}limited").numpy()
    ends = getattr(mujoco, f"actuator_{name}range").numpy()
    # of what no file says the importer of DC motors writes 0 0
    has_range = (getattr(mujoco, f"actuator_has_{name}range").numpy() > 0) & (
        ends[:, 0] < ends[:, 1]
    )
    return (limited == 1) | ((limited == _AUTO) & has_range & bool(mujoco.autolimits.numpy()[0]))


def depends_on_motion(mujoco: Any) -> np.ndarray:
    """Which actuators push by the length or the velocity of their transmission."""
    needs = np.zeros(len(mujoco.actuator_gaintype.numpy()), dtype=bool)
    for name in ("gain", "bias"):
        kinds = getattr(mujoco, f"actuator_{name}type").numpy()
        prm = getattr(mujoco, f"actuator_{name}prm").numpy()
        needs |= np.any(prm[:, 1:3] != 0.0, axis=1) & (kinds == _AFFINE)
        needs |= kinds > _AFFINE
    return needs


def reflected_armature(model: newton.Model, along: dict[int, int], count: int) -> np.ndarray:
    """What the armature of actuators adds to that of degrees of freedom or tendons [kg or kg m^2].

    Args:
        model: The model.
        along: What each actuator pushes along, by its row.
        count: How many such things there are.
    """
    added = np.zeros(count, dtype=np.float32)
    if along:
        mujoco: Any = model.mujoco
        rows = list(along)
        gear = mujoco.actuator_gear.numpy()[rows, 0]
        np.add.at(added, list(along.values()), gear**2 * mujoco.actuator_armature.numpy()[rows])
    return added


def axes_above(model: newton.Model) -> Callable[[int], Iterator[int]]:
    """Function that lists the degrees of freedom, of joints with axes, that move a link."""
    child, parent = model.joint_child.numpy(), model.joint_parent.numpy()
    starts, kinds = model.joint_qd_start.numpy(), model.joint_type.numpy().tolist()
    above: dict[int, int] = {}
    for joint in range(model.joint_count):
        above.setdefault(int(child[joint]), joint)

    def axes_of(link: int) -> Iterator[int]:
        seen = set()
        while link >= 0 and link in above and above[link] not in seen:
            joint = above[link]
            seen.add(joint)
            if KINDS[newton.JointType(kinds[joint])].has_axes:
                yield from range(starts[joint], starts[joint + 1])
            link = int(parent[joint])

    return axes_of


def passed_limits(model: newton.Model) -> list[int]:
    """Degrees of freedom with an effort limit past which actuators push, by tendons or on links."""
    found = Actuators.of_model(model)
    limited = set(np.flatnonzero(model.joint_effort_limit.numpy() < NO_LIMIT).tolist())
    if not limited or not (found.bodies or found.tendons):
        return []
    axes_of = axes_above(model)
    starts, links = model.joint_qd_start.numpy(), model.shape_body.numpy().tolist()
    passed: set[int] = set()
    for _, link, _, against, _ in found.bodies.values():
        passed |= set(axes_of(link)) ^ set(axes_of(against))
    for tendon in tendons(model):
        if tendon.row in found.tendons.values():
            ends = [element for element in tendon.path if element.index >= 0]
            if tendon.is_fixed:
                for end in ends:
                    passed.update(range(starts[end.index], starts[end.index + 1]))
                continue
            moved = [set(axes_of(links[end.index])) for end in ends]
            passed |= set().union(*moved) - moved[0].intersection(*moved)
    return sorted(passed & limited)


def compensating_axes(model: newton.Model, *, limited_only: bool = True) -> dict[int, list[int]]:
    """Degrees of freedom whose actuators compensate gravity, and the links that they carry.

    Args:
        model: The user's model.
        limited_only: Leave out axes without a limit (``actuatorfrcrange``). Compensation through
            an actuator differs from that of :data:`mujoco:gravcomp` alone only where it counts
            towards a limit.
    """
    through = authored(model, "jnt_actgravcomp")
    links = compensated_links(model)
    if through is None or links.size == 0 or not np.any(through):
        return {}
    limit = model.joint_effort_limit.numpy()
    axes_of = axes_above(model)
    carried: dict[int, list[int]] = {}
    for link in links.tolist():
        for dof in axes_of(link):
            if through[dof] and (not limited_only or limit[dof] < NO_LIMIT):
                carried.setdefault(dof, []).append(link)
    return carried

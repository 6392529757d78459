# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""What a model says about contacts in MuJoCo's terms: condim, priority and explicit pairs."""

from dataclasses import dataclass
from typing import Any

import newton
import numpy as np
import warp as wp

_DEFAULT = 3
"""The condim of a shape that does not say."""
CONDIMS = (1, 3, 4, 6)
"""All that there are."""
_COLUMNS = ((0, 1), (2, 2), (3, 4))
"""Where a pair's five coefficients have those of sliding, of twisting, of rolling."""


@dataclass(frozen=True, eq=False)
class Condims:
    """Shapes that MuJoCo's rules are for, and explicit pairs.

    A shape is MuJoCo's where ``add_mjcf`` made it, or where it has a condim or a priority other
    than MuJoCo's default: who registers the attributes and leaves them alone keeps Newton's rules.
    """

    condim: np.ndarray
    """By shape; empty where no shape and no pair is MuJoCo's."""
    is_own: np.ndarray
    """By shape: whether it is MuJoCo's."""
    pairs: np.ndarray
    """Shapes of each explicit pair, the lower index first, sorted, shape (pairs, 2)."""
    pair_condim: np.ndarray
    pair_friction: np.ndarray
    """As authored: two for sliding, one for twisting, two for rolling [m], shape (pairs, 5)."""
    pair_margin: np.ndarray

    @classmethod
    def of_model(cls, model: newton.Model | None) -> "Condims":
        """Reads a model; copies its arrays to the host. None for a model without any."""
        mujoco: Any = getattr(model, "mujoco", None)
        authored = getattr(mujoco, "condim", None)
        none = np.zeros(0, dtype=int)
        if model is None or authored is None or model.shape_count == 0:
            return cls(none, none, np.zeros((0, 2), dtype=int), none, np.zeros((0, 5)), none)
        condim = authored.numpy()
        is_own = condim != _DEFAULT
        for name, unset in (("geom_priority", 0), ("collision_mask_domain", -1)):
            values = getattr(mujoco, name, None)
            if values is not None:
                is_own = is_own | (values.numpy() != unset)
        pairs, items = _pairs(model)
        if not is_own.any() and not items.size:
            condim, is_own = none, none
        return cls(
            condim,
            is_own,
            pairs[items],
            *(_of_pairs(model, name, items) for name in ("condim", "friction", "margin")),
        )

    def labels(self, model: newton.Model) -> list[str]:
        """What to call the pairs."""
        labels = model.shape_label
        return [f"{labels[first]} - {labels[other]}" for first, other in self.pairs]

    def slides(self) -> np.ndarray:
        """By shape: whether it, or a pair of it, lets contacts resist sliding."""
        return self._at_least(3)

    def twists(self) -> np.ndarray:
        """By shape: whether it, or a pair of it, lets contacts resist twisting or rolling."""
        return self._at_least(4)

    def _at_least(self, condim: int) -> np.ndarray:
        wanted = self.condim >= condim
        wanted[self.pairs[self.pair_condim >= condim]] = True
        return wanted

    def signed(self, *, angular_friction: bool | None, is_mixed: bool) -> np.ndarray:
        """Condims as :attr:`.data.ShapeModel.condim` has them.

        Args:
            angular_friction: Whether all contacts that resist sliding resist twisting and rolling,
                or none; None where the condim says.
            is_mixed: Whether a rule is asked for by which the coefficients of all shapes mix.
        """
        condim = _with_angular(self.condim, angular_friction)
        return np.where(self.is_own & (not is_mixed), condim, -condim)

    def friction_of_pairs(self, angular_friction: bool | None) -> np.ndarray:
        """Coefficients (sliding, torsional, rolling) that act, shape (pairs, 3)."""
        condim = _with_angular(self.pair_condim, angular_friction)
        friction = np.zeros((len(self.pairs), 3))
        for k, (first, last) in enumerate(_COLUMNS):
            mean = 0.5 * (self.pair_friction[:, first] + self.pair_friction[:, last])
            friction[:, k] = np.where(condim >= CONDIMS[k + 1], mean, 0.0)
        return friction

    def uneven_pairs(self) -> np.ndarray:
        """Pairs with another friction in one direction than across it, where that acts."""
        uneven = np.zeros(len(self.pairs), dtype=bool)
        for k, (first, last) in enumerate(_COLUMNS):
            acts = self.pair_condim >= CONDIMS[k + 1]
            uneven |= acts & (self.pair_friction[:, first] != self.pair_friction[:, last])
        return np.flatnonzero(uneven)


def _pairs(model: newton.Model) -> tuple[np.ndarray, np.ndarray]:
    """Shapes of all rows of explicit pairs, and the first row of each two shapes, sorted."""
    count = model.custom_frequency_counts.get("mujoco:pair", 0)
    if count == 0:
        return np.zeros((0, 2), dtype=int), np.zeros(0, dtype=int)
    mujoco: Any = model.mujoco
    ends = [mujoco.pair_geom1.numpy()[:count], mujoco.pair_geom2.numpy()[:count]]
    pairs = np.sort(np.column_stack(ends).astype(int), axis=1)
    _, items = np.unique(pairs, axis=0, return_index=True)
    return pairs, items[pairs[items, 0] >= 0]


def _of_pairs(model: newton.Model, name: str, items: np.ndarray) -> np.ndarray:
    """An attribute of explicit pairs."""
    if items.size == 0:
        return np.zeros((0, 5)) if name == "friction" else np.zeros(0)
    return getattr(model.mujoco, f"pair_{name}").numpy()[items]


def _with_angular(condim: np.ndarray, angular_friction: bool | None) -> np.ndarray:
    """Condims where twisting and rolling is asked for, or asked not to be."""
    if angular_friction is None:
        return condim
    return np.where(condim < _DEFAULT, condim, 6 if angular_friction else _DEFAULT)


def condim_arrays(
    condims: Condims, model: newton.Model, *, angular_friction: bool | None, is_mixed: bool
) -> dict[str, wp.array]:
    """Arrays by their names in :class:`.data.ShapeModel`; for arguments see :class:`Condims`."""
    if condims.condim.size == 0:
        return {}
    priority = getattr(model.mujoco, "geom_priority", None)
    with wp.ScopedDevice(model.device):
        if priority is None:
            priority = wp.zeros(model.shape_count, dtype=wp.int32)
        signed = condims.signed(angular_friction=angular_friction, is_mixed=is_mixed)
        arrays = {
            "condim": wp.array(signed, dtype=wp.int32),
            "priority": wp.array(priority.numpy(), dtype=wp.int32),
        }
        if len(condims.pairs):
            starts = np.searchsorted(condims.pairs[:, 0], np.arange(model.shape_count + 1))
            friction = condims.friction_of_pairs(angular_friction)
            arrays |= {
                "pair_start": wp.array(starts, dtype=wp.int32),
                "pair_other": wp.array(condims.pairs[:, 1], dtype=wp.int32),
                "pair_friction": wp.array(friction, dtype=wp.vec3),
                "pair_margin": wp.array(condims.pair_margin, dtype=float),
                "margin": wp.clone(model.shape_margin),
            }
    return arrays

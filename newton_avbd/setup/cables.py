# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""The arrays of Newton's tendons, cables here, what is launched for them, and what a user reads."""

from collections.abc import Iterator
from itertools import pairwise
from typing import Any

import newton
import numpy as np
import warp as wp

from .. import data
from ..drivers.launch import Launcher
from ..model.topology import Topology, find_root, moving
from ..model.welds import Welds, multiply
from ..step import routes as kernels

ACTIVATION = 2.0e-3
"""Share of its radius by which a dynamic roller reaches into a cable that it is to take up, as in
SolverXPBD."""
_FIXED = (
    *("tendon_start", "tendon_world", "tendon_guide_body", "tendon_guide_type"),
    *("tendon_guide_radius", "tendon_guide_orientation", "tendon_guide_flags"),
    *("tendon_guide_offset", "tendon_guide_axis"),
)
"""Arrays of a model that say how its cables run."""
_MATERIAL = (
    *("_tendon_initialized", "_tendon_rebaseline", "tendon_segment_rest_length"),
    *("tendon_segment_attachment_l_local", "tendon_segment_attachment_r_local"),
    "tendon_guide_active",
)
"""Arrays of a state that hold how its cables stand, in the order of ``CableState``."""


def cabled_links(model: newton.Model) -> np.ndarray:
    """Links that a cable touches, in order."""
    if model.tendon_count == 0:
        return np.zeros(0, dtype=int)
    links = np.unique(model.tendon_guide_body.numpy())
    return links[links >= 0]


def cabled_bodies(model: Any) -> np.ndarray:
    """Bodies of the solver that a cable touches and that move, shape (body_count,)."""
    is_cabled = np.zeros(model.body_count, dtype=bool)
    links = cabled_links(model)
    of_link = getattr(model, "body_of_link", None)
    bodies = links if of_link is None else of_link[links]
    is_cabled[bodies[bodies >= 0]] = True
    return is_cabled & moving(model) if model.body_count else is_cabled


class Cables:
    """The arrays by which cables act, and what a step launches."""

    def __init__(
        self, model: newton.Model, solved: Any, welds: Welds, topology: Topology, launch: Launcher
    ) -> None:
        """Makes the arrays, and finds how the cables stand in the initial poses.

        Args:
            model: The user's model.
            solved: The model as the solver solves it.
            welds: Which links of the user's model are one body.
            topology: Which bodies are solved at once.
            launch: Launches kernels.
        """
        self._model = model
        self._welds = welds
        self._routes = {name: getattr(model, name).numpy().copy() for name in _FIXED}
        self.work = work = data.CableWork()
        with wp.ScopedDevice(model.device):
            self._make_clusters(solved, topology)
            count = model.tendon_guide_count
            struct: Any = data.CableGuide
            self._guides: Any = np.zeros(count, dtype=struct.numpy_dtype())
            self._place_guides(solved)
            data.fill(work, guides=self._guides)
            self._make_work(solved, topology)
            self.view = kernels.CableView()
            segments = model.tendon_segment_count
            data.allocate(self.view, segments, "left", "right", "length")
            data.allocate(self.view, segments, "material_tension", "damping_tension")
            self._initial = _new_state(model)
            self._state = _new_state(model)
            self.total = wp.zeros(model.tendon_count, dtype=float)
            self.segment_guide = wp.array(
                np.arange(segments) + np.repeat(np.arange(work.cables.size), self._counts),
                dtype=wp.int32,
            )
        self._bound: tuple[Any, ...] = ()
        self._bind()
        self._find_initial(launch)

    def _bind(self) -> None:
        """Points the kernels to the model's arrays."""
        model = self._model
        self._view_of_model = kernels.CableModel()
        self._view_of_model.world = model.tendon_world
        self._view_of_model.body = model.tendon_guide_body
        self._view_of_model.mu = model.tendon_guide_mu
        self._view_of_model.compliance = model.tendon_segment_compliance
        self._view_of_model.damping = model.tendon_segment_damping

    def _make_clusters(self, solved: Any, topology: Topology) -> None:
        """Which cables share blocks, and to which worlds they belong."""
        model, work = self._model, self.work
        start = model.tendon_start.numpy()
        self._counts = np.diff(start) - 1
        count = model.tendon_count
        link = model.tendon_guide_body.numpy()
        body = np.where(link >= 0, self._welds.body[link], -1)
        moves = np.append(moving(solved), False) if solved.body_count else np.zeros(1, bool)
        cable_of = np.repeat(np.arange(count), np.diff(start))
        blocks = np.append(topology.block_end[topology.rank], -1)[body]
        root = list(range(count))
        seen: dict[int, int] = {}
        for cable, block in zip(cable_of[moves[body]], blocks[moves[body]], strict=True):
            first = find_root(root, seen.setdefault(int(block), int(cable)))
            root[find_root(root, int(cable))] = first
        # a cluster that moves nothing goes with any world
        world = np.zeros(count, dtype=int)
        of_body = np.append(topology.worlds, 0)[body]
        for cable, its in zip(cable_of[moves[body]], of_body[moves[body]], strict=True):
            world[cable] = its
        cluster = np.array([find_root(root, cable) for cable in range(count)])
        order = np.lexsort((np.arange(count), cluster, world))
        cluster = cluster[order]
        firsts = np.flatnonzero(np.append(True, np.diff(cluster) != 0))
        rows = self._counts[order]
        ends = np.append(firsts, count)
        size = np.add.reduceat(rows, firsts)
        before = np.cumsum(rows) - rows
        world_of = world[order][firsts]
        worlds = int(topology.worlds.max(initial=0)) + 1
        data.fill(work, world_start=np.searchsorted(world_of, np.arange(worlds + 1)))
        data.fill(work, world=world_of, cluster_start=ends, cables=order, size=size)
        first_segment = start[:-1] - np.arange(count)
        row = np.zeros(model.tendon_segment_count, dtype=int)
        for place, cable in enumerate(order):
            its = np.arange(self._counts[cable])
            opening = firsts[np.searchsorted(firsts, place, side="right") - 1]
            row[first_segment[cable] + its] = before[place] - before[opening] + its
        data.fill(work, row=row, first_row=before[firsts], guide_start=start)
        data.fill(work, matrix_start=np.append(0, np.cumsum(size**2)))
        data.allocate(work, int(np.sum(size**2)), "mobility", "matrix")

    def _place_guides(self, solved: Any) -> None:
        """Where the guides are on the bodies of the solver."""
        model = self._model
        guides = self._guides
        link = model.tendon_guide_body.numpy()
        offset = model.tendon_guide_offset.numpy()
        frame = np.vstack([self._welds.frame, [[0, 0, 0, 0, 0, 0, 1.0]]])[link]
        body = np.append(self._welds.body, -1)[link]
        place = np.hstack([offset, np.tile([0, 0, 0, 1.0], (len(link), 1))])
        com = np.vstack([solved.body_com.numpy().reshape(-1, 3), np.zeros((1, 3))])[body]
        guides["kind"] = model.tendon_guide_type.numpy()
        guides["slot"] = np.where(body >= 0, body, solved.body_count)
        guides["arm"] = multiply(frame, place)[:, :3] - com
        guides["turn"] = frame[:, 3:]
        guides["offset"] = offset
        guides["axis"] = model.tendon_guide_axis.numpy()
        guides["radius"] = model.tendon_guide_radius.numpy()
        guides["side"] = model.tendon_guide_orientation.numpy()
        flags = model.tendon_guide_flags.numpy()
        guides["is_dynamic"] = flags & int(newton.TendonGuideFlags.DYNAMIC) != 0

    def _make_work(self, solved: Any, topology: Topology) -> None:
        """Buffers by guide, segment and body slot."""
        model, work = self._model, self.work
        slots, segments = solved.body_count + 1, model.tendon_segment_count
        data.allocate(work, model.tendon_guide_count, "mu", "touched", "slip", "ratio")
        data.allocate(work, segments, "active", "left", "right", "chain", "group", "compliance")
        data.allocate(work, segments, "damping", "rest", "lost", "left_over", "tension", "before")
        data.allocate(work, segments, "base_left", "base_right", "spoke_left", "spoke_right")
        data.allocate(work, segments, "direction", "start", "misfit", "stretch", "weight", "load")
        data.allocate(work, segments, "pull", "answer", "kept", "length", "slack")
        data.allocate(work, slots, "wrench", "push", "update", "ll", "al", "aa", "pulled")
        data.allocate(work, 2 * segments, "way", "arm")
        data.allocate(work, int(topology.axis_start[-1]), "axis_push")

    def _find_initial(self, launch: Launcher) -> None:
        """How the cables stand in the initial poses: authored lengths, and measured ones."""
        model, work, initial = self._model, self.work, self._initial
        authored = model.tendon_segment_rest_length.numpy()
        is_measured = authored < 0.0
        start = model.tendon_start.numpy()
        initial.rest.assign(np.maximum(authored, 0.0))
        # from the guides themselves tangents are found anew
        offset = model.tendon_guide_offset.numpy()
        left = self.segment_guide.numpy()
        initial.left.assign(offset[left])
        initial.right.assign(offset[left + 1])
        self._state.is_known.zero_()
        self._state.is_placed.fill_(True)
        guides = self._guides
        dynamic = np.flatnonzero(guides["is_dynamic"])

        def measure() -> tuple[np.ndarray, np.ndarray]:
            """Lengths of the segments and angles at their right guides."""
            launch(
                kernels.begin_cables,
                model.tendon_count,
                [self._view_of_model, model.body_q, self._state, initial, ACTIVATION, work],
            )
            return work.active.numpy() == 1, work.start.numpy() + work.rest.numpy()

        # What bypasses a dynamic guide: the route without any of them.
        initial.touched.assign(~guides["is_dynamic"])
        touched = np.ones(len(guides), dtype=bool)
        if dynamic.size:
            guides["detour"] = 0.0
            radius = guides["radius"].copy()
            # what ends that far away is not touched
            guides["radius"][dynamic] = -np.inf
            work.guides.assign(guides)
            _, length = measure()
            guides["radius"] = radius
            cables = np.searchsorted(start, dynamic, side="right") - 1
            guides["detour"][dynamic] = length[dynamic - cables - 1]
            work.guides.assign(guides)
            measure()
            touched = work.touched.numpy()
        initial.touched.assign(touched)
        active, length = measure()
        rest = np.maximum(authored, 0.0)
        for guide in dynamic[~touched[dynamic]]:
            cable = int(np.searchsorted(start, guide, side="right")) - 1
            one, other = guide - cable - 1, guide - cable
            whole = rest[one] + rest[other]
            if is_measured[one] or is_measured[other]:
                whole = max(whole, guides["detour"][guide])
            rest[one], rest[other] = max(whole, 1.0e-6), 1.0e-6
            is_measured[[one, other]] = False
        rest = np.where(is_measured & active, length, rest)
        initial.rest.assign(rest)
        initial.left.assign(work.base_left)
        initial.right.assign(work.base_right)
        work.rest.assign(rest)
        self._measure_total(rest, active)
        self._state.is_placed.zero_()
        self._authored = authored.copy()
        # what is shown before the first step
        launch(
            kernels.end_cables,
            model.tendon_count,
            [self._view_of_model, model.body_q, 1.0, work, self._state, self.view],
        )
        work.rest.assign(rest)
        work.left_over.zero_()
        work.lost.zero_()

    def _measure_total(self, rest: np.ndarray, active: np.ndarray) -> None:
        """Material of each cable, what winds around its rollers included."""
        model, work = self._model, self.work
        guides, start = work.guides.numpy(), model.tendon_start.numpy()
        base_left, base_right = work.base_left.numpy(), work.base_right.numpy()
        total = np.zeros(model.tendon_count)
        for cable in range(model.tendon_count):
            first = start[cable] - cable
            chain = [s for s in range(first, first + self._counts[cable]) if active[s]]
            total[cable] = rest[chain].sum()
            for one, other in pairwise(chain):
                guide = guides[other + cable]
                if guide["kind"] == int(newton.TendonGuideType.ROLLER):
                    a, b = base_right[one] - guide["offset"], base_left[other] - guide["offset"]
                    turned = np.arctan2(np.dot(np.cross(a, b), guide["axis"]), np.dot(a, b))
                    total[cable] += abs(turned) * guide["radius"]
        self.total.assign(total)

    def refresh(self, solved: Any, launch: Launcher) -> None:
        """Looks at the model again: a new authored length is what a reset leads to.

        Args:
            solved: The model as the solver solves it, whose centers of mass may have moved.
            launch: Launches kernels.

        Raises:
            ValueError: If the cables run otherwise than when the solver was made.
        """
        model = self._model
        for name, values in self._routes.items():
            if not np.array_equal(getattr(model, name).numpy(), values):
                raise ValueError(
                    f"model.{name} has changed: make a new model and a new SolverAVBD. Friction, "
                    "compliance, damping and rest lengths of tendons may change."
                )
        self._bind()
        self._place_guides(solved)
        self.work.guides.assign(self._guides)
        if not np.array_equal(model.tendon_segment_rest_length.numpy(), self._authored):
            kept = {name: wp.clone(array) for name, array in self.remembered()}
            self._find_initial(launch)
            for name, array in self.remembered():
                wp.copy(array, kept[name])

    def begin(self, launch: Launcher, state: newton.State) -> None:
        """Finds the routes of a step."""
        launch(
            kernels.begin_cables,
            self._model.tendon_count,
            [
                self._view_of_model,
                state.body_q,
                self._of_state(state),
                self._initial,
                ACTIVATION,
                self.work,
            ],
        )

    def end(self, launch: Launcher, state: newton.State, dt: float) -> None:
        """Writes how the cables stand after a step to its state."""
        launch(
            kernels.end_cables,
            self._model.tendon_count,
            [self._view_of_model, state.body_q, dt, self.work, self._of_state(state), self.view],
        )

    def reset(self, launch: Launcher, state: newton.State, mask: wp.array) -> None:
        """Puts the material of the cables of masked worlds back; of all, with an empty mask."""
        launch(
            kernels.reset_cables,
            self._model.tendon_count,
            [self._view_of_model, mask, self._initial, self.work, self._of_state(state)],
        )

    def remembered(self) -> Iterator[tuple[str, wp.array]]:
        """Arrays that a step leaves to the next one, by name; what else there is, states have."""
        for name in ("tension", "slip", "slack", "left_over", "rest", "lost"):
            yield f"cables.{name}", getattr(self.work, name)

    def _of_state(self, state: newton.State) -> Any:
        """A state's arrays of cables.

        Raises:
            ValueError: If it has none.
        """
        arrays = tuple(getattr(state, name, None) for name in _MATERIAL)
        for known, seen in self._bound:
            if all(a is b for a, b in zip(known, arrays, strict=True)):
                return seen
        if any(array is None for array in arrays):
            raise ValueError(
                "A state without the model's tendons: create it with model.state() after the "
                "tendons were added."
            )
        view: Any = kernels.CableState()
        view.is_known, view.is_placed, view.rest, view.left, view.right, view.touched = arrays
        self._bound = (*self._bound[-7:], (arrays, view))
        return view


def _new_state(model: newton.Model) -> Any:
    """Arrays of cables as a state has them."""
    state = kernels.CableState()
    segments = model.tendon_segment_count
    data.allocate(state, model.tendon_count, "is_known")
    data.allocate(state, model.world_count + 1, "is_placed")
    data.allocate(state, segments, "rest", "left", "right")
    state.touched = wp.ones(model.tendon_guide_count, dtype=wp.bool)
    return state


class _Shown:
    """An array of the solver's cables under Newton's name; None without cables."""

    def __init__(self, path: str, doc: str) -> None:
        self._path, self.__doc__ = path, doc

    def __get__(self, solver: Any, owner: type | None = None) -> Any:
        if solver is None:
            return self
        value = solver._cables
        for name in self._path.split(".") if value is not None else ():
            value = getattr(value, name)
        return value


class CableViews:
    """What scripts read off SolverXPBD and SolverVBD of their tendons, under the same names.

    Arrays on the device, of the end of the last step; None in models without tendons.
    """

    _cables: Cables | None

    tendon_activation_tol = ACTIVATION
    tendon_segment_rest_length = _Shown("work.rest", "Material of each segment [m].")
    tendon_segment_attachment_l = _Shown("view.left", "Left end of each segment [m].")
    tendon_segment_attachment_r = _Shown("view.right", "Right end of each segment [m].")
    tendon_segment_attachment_l_local = _Shown(
        "work.base_left", "Left end in the frame of its body [m]."
    )
    tendon_segment_attachment_r_local = _Shown(
        "work.base_right", "Right end in the frame of its body [m]."
    )
    tendon_segment_length = _Shown("view.length", "Length of each segment [m].")
    tendon_segment_active = _Shown("work.active", "1 for each segment of the route.")
    tendon_segment_active_guide_l = _Shown("work.left", "Guide at its left end.")
    tendon_segment_active_guide_r = _Shown("work.right", "Guide at its right end.")
    tendon_segment_active_compliance = _Shown("work.compliance", "Its compliance [m/N].")
    tendon_segment_active_damping = _Shown("work.damping", "Its damping [N s/m].")
    tendon_segment_guide_l = _Shown("segment_guide", "Authored guide at its left end.")
    tendon_segment_material_tension = _Shown(
        "view.material_tension",
        "Tension by stretch [N], of an inextensible segment the whole tension.",
    )
    tendon_segment_damping_tension = _Shown("view.damping_tension", "Tension by damping [N].")
    tendon_guide_active = _Shown("work.touched", "Whether the cable touches each guide.")
    tendon_total_cable = _Shown("total", "Material of each cable in the initial poses [m].")

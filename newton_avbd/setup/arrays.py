# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""What a solver's kernels see of the model, and the arrays they work on: when which are made."""

import dataclasses
import warnings
from collections.abc import Callable, Iterator
from typing import Any
from weakref import WeakKeyDictionary

import newton
import numpy as np
import warp as wp

from .. import data
from ..attributes import BREAK_LIMITS, authored_fluid, break_limits
from ..checks import check_array
from ..drivers import world_smooth
from ..drivers.large import FEW, LARGE, LargeWorlds, obstacles
from ..drivers.launch import Launcher
from ..drivers.scan import scratch_size
from ..effects import Callers, Effects
from ..model.actuators import ACTING
from ..model.callers import bodies_in_fluid, free_joints, linking_joints, pushing_joints
from ..model.condim import Condims, condim_arrays
from ..model.limits import limit_law, limits_within_margins
from ..model.tendons import tendon_count
from ..model.topology import Topology, mimics, moving
from ..model.welds import Welds
from ..rows.joint import KINDS
from ..settings import Settings
from ..step.block_start import UNKNOWN
from ..step.fluid import find_boxes
from ..step.sleepers import AWAKE, STILL
from . import buffers, inner_steps, views
from .actuation import Actuation
from .actuator_force import ActuatorForce
from .cables import Cables, cabled_bodies
from .joined import JoinedModel
from .solved import SolvedModel, solved_model

_BOUND = ("body_", "joint_", "shape_material_", "shape_body", "gravity")
"""How the arrays of a model begin that the kernels read."""
_CONTACT_ARRAYS = ("shape0", "shape1", "point0", "point1", "normal", "margin0", "margin1")
_EXTRA_CONTACT_ARRAYS = ("surface_velocity", "stiffness", "damping", "friction", "match_index")
"""Some buffers have these."""


_STEPS = 4
"""Steps of which the arguments are kept: states take turns."""
_GIVEN = ("body_q", "body_qd", "body_f", "control", "contacts", "body_q_out", "body_qd_out")
"""What a step is made of that is no number."""


class SolverArrays:
    """Arrays of a solver, made when its model, the grouping of bodies or contacts call for them.

    :class:`.solver.SolverAVBD` is one. Which body belongs to which world and block, and which
    effects there are, is found out here, too, since all arrays follow from that.
    """

    model: newton.Model
    device: wp.Device
    _joined: JoinedModel
    """The model with the joints that it lacks."""
    _solved: newton.Model | SolvedModel
    """The model as the solver solves it: what welds join is one body."""
    _retired: list[tuple]
    """What graphs that were captured before arrays were made anew go on using."""
    contacts: newton.Contacts | None
    settings: Settings
    iterations: int
    tolerance: float
    _activations: wp.array
    _launch: Launcher
    _remembered: Callable[[], Iterator[tuple[str, wp.array]]]
    _without: frozenset[str]
    _parallel: str | None

    def _make_arrays(self) -> None:
        """Makes all arrays that can be made before the first step."""
        self._welds = self._find_welds()
        self._solved = solved_model(self._joined, self._welds) or self.model
        self._refresh_solved()
        self._actuation: Actuation | None = None
        self._actuator_force: ActuatorForce | None = None
        self._cables: Cables | None = None
        self._limit_law: dict[str, wp.array] = {}
        self._ctrl: wp.array | None = None
        self._weld_loads: data.LinkLoads | None = None
        self._weld_contact_f: Any = None
        self._weld_joint_f: Any = None
        self._flags: Effects
        self._callers: Callers
        self._worlds: data.WorldWork
        self._topology: Topology | None = None
        self._large: LargeWorlds | None = None
        self._colors: data.ColorWork | None = None
        self._sleep = data.SleepWork()
        self._whole: data.Context | None = None
        self._seen: data.Context | None = None
        self._steps: dict[tuple, tuple[Any, list]] = {}
        self._step: Any = None
        self._seen_worlds = data.WorldWork()
        self._seen_history = data.History()
        self._inputs: WeakKeyDictionary[newton.Contacts, data.ContactInput] = WeakKeyDictionary()
        self._buffer_count = 0
        self._moving_surfaces = False
        self._is_listed = False
        self._listed: list[tuple[str, int]] = []
        self._mimics: wp.array | None = None
        self._condims: dict[str, wp.array] = {}
        self._boxes: tuple[wp.array, ...] = ()
        self._capacity = 0
        self._allocate_bodies()
        self._bind_model()
        self._group_worlds()
        if self._flags.contact and self.contacts is not None:
            self._contact_input(self.contacts)
        elif self._flags.contact and self.model.rigid_contact_max:
            self._allocate_contacts(self.model.rigid_contact_max)

    def _find_welds(self, before: Welds | None = None) -> Welds:
        """Which links of the model are one body, as ``before`` where nothing but masses changed."""
        return Welds.of_model(
            self._joined.whole,
            wanted="welds" not in self._without,
            breakable="breaking" not in self._without,
            before=before,
        )

    def _has_other_bodies(self) -> bool:
        """Whether other links are one body than so far, or the solver knows other joints, or
        massless links are new to it."""
        self._joined.reread()
        welds = self._find_welds(self._welds)
        is_plain = not isinstance(self._solved, SolvedModel)
        return welds != self._welds or (is_plain and solved_model(self._joined, welds) is not None)

    def _refresh_solved(self) -> None:
        """Makes what is solved follow the model's masses and joint frames, on the device."""
        if isinstance(self._solved, SolvedModel):
            self._solved.refresh(self._launch)

    def _make_arrays_anew(self) -> None:
        """Makes all arrays for another grouping of links.

        Only the turns of joints are kept, and which have broken.
        """
        # graphs that were captured before go on using the old arrays
        self._retired.append(tuple(vars(self).values()))
        turns, broken, joint = self._history.joint_angle, self._history.broken, self._welds.joint
        self._make_arrays()
        if turns is not None and self._history.joint_angle is not None:
            wp.copy(self._history.joint_angle, turns)
        if broken is not None and self._history.broken is not None:
            is_broken = np.zeros(self._joined.whole.joint_count, dtype=bool)
            is_broken[joint] = broken.numpy()
            self._history.broken.assign(is_broken[self._welds.joint])

    def _allocate_bodies(self) -> None:
        """Buffers by body slot; the last slot is the static world, which stays zero."""
        model = self._solved
        slots = model.body_count + 1
        free = free_joints(model)
        free_dof = np.full(model.body_count, -1)
        if model.joint_count:
            free_dof = np.where(free >= 0, model.joint_qd_start.numpy()[free], -1)
        self._no_contacts = data.ContactInput()
        self._control = data.ControlInput()
        self._control_arrays: tuple[wp.array | None, ...] = (None, None, None)
        is_linked = linking_joints(model).size > 0
        is_linked |= self.model.tendon_count > 0 or tendon_count(model) > 0
        with wp.ScopedDevice(self.device):
            self._no_mask = wp.empty(0, dtype=wp.bool)
            self._free_joint = wp.array(free if is_linked else free[:0], dtype=wp.int32)
            self._free_dof = wp.array(free_dof, dtype=wp.int32)
            self._pushing = wp.array(pushing_joints(model), dtype=wp.int32)
            self._work = buffers.body_work(slots, self.settings.second_order)
            self._islands = buffers.island_work(slots)
            self._rows = buffers.row_work(slots)
            self._history = buffers.history(
                model, self.settings.second_order, is_linked, self._sides
            )
            self._rest_angle = wp.array(self._initial_angles(), dtype=wp.float64)

    def _initial_angles(self) -> np.ndarray:
        """Coordinate of each joint axis in the model, with its turns, shape (joint_dof_count,)."""
        model = self._solved
        angles = np.zeros(model.joint_dof_count, dtype=np.float32)
        if model.joint_count:
            joint_q, types = model.joint_q.numpy(), model.joint_type.numpy().tolist()
            q_start, qd_start = model.joint_q_start.numpy(), model.joint_qd_start.numpy()
            for joint in np.flatnonzero([KINDS[kind].has_axes for kind in types]):
                count = qd_start[joint + 1] - qd_start[joint]
                angles[qd_start[joint] :][:count] = joint_q[q_start[joint] :][:count]
        return angles

    def _bind_model(self) -> None:
        """Points the kernels to the model's arrays."""
        self._forget_launches()
        model = self._solved
        self._bound = {
            name: array
            for name, array in vars(self.model).items()
            if name.startswith(_BOUND) and isinstance(array, wp.array)
        }
        self._bodies = views.body_model(model, self._free_joint, self._free_dof)
        self._joints = views.joint_model(model)
        self._shapes = views.shape_model(model)
        self._bind_condims()
        self._bind_fluid()
        if model.joint_count:
            self._bind_mimics()
            self._bind_break_limits()
            for name, values in self._limit_law.items():
                setattr(self._joints, name, values)
        if self._actuation is not None:
            self._actuation.bind(self._joints, self._bodies)

    def _bind_fluid(self) -> None:
        """The fluid that bodies are in, and their boxes; again after masses have changed."""
        model = self._solved
        if not self.device.is_capturing and bodies_in_fluid(model).size and not self._boxes:
            start, links = np.arange(model.body_count + 1), np.arange(model.body_count)
            if isinstance(model, SolvedModel):
                start = model.links.member_start.numpy()
                links = model.links.members.numpy()[: start[-1]]
            with wp.ScopedDevice(self.device):
                self._boxes = (
                    wp.array(start, dtype=wp.int32),
                    wp.array(links, dtype=wp.int32),
                    wp.empty(links.size, dtype=data.FluidBox),
                )
        authored, fluid = authored_fluid(self.model), self._bodies.fluid
        if not self._boxes or authored is None:
            return
        fluid.density, fluid.viscosity = authored.density, authored.viscosity
        fluid.wind = authored.wind
        fluid.box_start, link_of, fluid.boxes = self._boxes
        welded = model.links if isinstance(model, SolvedModel) else data.LinkModel()
        mass, inertia = self.model.body_mass, self.model.body_inertia
        self._launch(find_boxes, link_of.shape[0], [welded, mass, inertia, link_of, fluid.boxes])

    def _bind_condims(self) -> None:
        """What contacts take of MuJoCo's attributes; a captured graph keeps what it has."""
        if not self.device.is_capturing:
            found = condim_arrays(
                Condims.of_model(self.model if "condim" not in self._without else None),
                self.model,
                angular_friction=self.settings.angular_friction,
                is_mixed=self.settings.friction_mix_mode is not None,
            )
            # graphs that were captured before go on using the old arrays
            self._retired.append(tuple(self._condims.values()))
            for name, values in found.items():
                old = self._condims.get(name)
                if old is not None and old.shape == values.shape:
                    wp.copy(old, values)
                    found[name] = old
            self._condims = found
        for name, values in self._condims.items():
            setattr(self._shapes, name, values)

    def _bind_mimics(self) -> None:
        """Chains of mimic joints and sparse ones have coefficients that the model's array lacks."""
        if not self.device.is_capturing:
            _, coefficients = mimics(self._solved)
            if self._mimics is not None:
                self._mimics.assign(coefficients)
            elif np.any(coefficients != self._solved.joint_mimic_coeffs.numpy()):
                self._mimics = wp.array(coefficients, dtype=wp.vec2, device=self.device)
        if self._mimics is not None:
            self._joints.mimic_coefficients = self._mimics

    def _bind_break_limits(self) -> None:
        """Joints that can break are enabled by an array of the solver's own."""
        if not self.device.is_capturing:
            left = "breaking" in self._without
            self._break_limits = {} if left else break_limits(self._solved)
        if not self._break_limits:
            return
        if self._history.broken is None:
            count = self._solved.joint_count
            with wp.ScopedDevice(self.device):
                self._history.broken = wp.zeros(count, dtype=wp.bool)
                self._is_whole = wp.zeros(count, dtype=wp.bool)
                self._unbreakable = wp.full(count, float("inf"), dtype=float)
        names = list(BREAK_LIMITS)
        self._joints.break_force = self._break_limits.get(names[0], self._unbreakable)
        self._joints.break_torque = self._break_limits.get(names[1], self._unbreakable)
        self._joints.enabled = self._bodies.joint_enabled = self._is_whole

    def _solver_worlds(self, model: newton.Model) -> np.ndarray:
        """Which world, as the solver sees it, each body belongs to, shape (body_count,)."""
        if model.body_count == 0:
            return np.zeros(0, dtype=np.int32)
        world = model.body_world.numpy()
        is_global = world < 0
        ties = is_global & moving(model)
        if self.settings.accuracy is not None:
            # worlds whose steps differ cannot share what is moved from one to the next
            ties = is_global
        if np.any(ties) or np.all(is_global):
            return np.zeros(model.body_count, dtype=np.int32)
        # global bodies that do not move get a world of their own, which only passes them through
        return np.where(is_global, model.world_count, world).astype(np.int32)

    def _look_at_model(self, solved: Any) -> tuple[np.ndarray, Topology, Effects, Callers]:
        """Which world each body belongs to, what is solved together, and with which effects.

        Args:
            solved: The model as it is to be solved.
        """
        groups = self._solver_worlds(solved)
        cabled = np.zeros(solved.body_count, dtype=bool)
        if "cables" not in self._without:
            cabled = cabled_bodies(solved)
        topology = Topology.of_model(
            solved,
            groups,
            trees=self.settings.blocks == "articulation",
            cabled=cabled,
            has_tendons="tendons" not in self._without,
        )
        settings, without = self.settings, self._without
        flags, callers = Effects.of_model(solved, topology, settings, without=without)
        if flags.adaptive:
            inner_steps.check_effects(flags)
        if flags.cables and (flags.sleeping or flags.ramp):
            what = "sleeping=True" if flags.sleeping else "formulation='ramp'"
            raise NotImplementedError(
                f"SolverAVBD does not simulate the model's {self.model.tendon_count} tendons with "
                f"{what}. Leave that out, or the tendons with effects={{'cables': False}}."
            )
        takes_bodies = self._takes_bodies(groups, flags)
        if takes_bodies:
            flags = flags.leaving_out(frozenset({"piles", "mixing"}))
        if flags.fourth_order:
            found = world_smooth.obstacles(flags) + takes_bodies * ["parallel='bodies'"]
            if found:
                flags = flags.leaving_out(frozenset({"fourth_order"}))
                if self._topology is None and self.settings.accuracy is None:
                    warnings.warn(
                        "SolverAVBD: scheme='runge_kutta' takes steps of second order, as "
                        f"'generalized_alpha' does, with {' and '.join(found)}.",
                        stacklevel=2,
                    )
        return groups, topology, flags, callers

    def _takes_bodies(self, groups: np.ndarray, flags: Effects) -> bool:
        """Whether the bodies are solved color by color, as one large world.

        Raises:
            NotImplementedError: If that is asked for and cannot be.
        """
        if self._parallel == "worlds" or not flags.contact:
            return False
        if flags.adaptive:
            if self._parallel == "bodies":
                raise NotImplementedError(
                    "parallel='bodies' does not choose its own steps. Leave parallel or accuracy "
                    "out."
                )
            return False
        if self._parallel is None:
            sizes = np.bincount(groups)
            if not self.device.is_cuda or sizes.max(initial=0) < LARGE or sizes.size > FEW:
                return False
        found = obstacles(flags)
        if found and self._parallel == "bodies":
            raise NotImplementedError(
                f"parallel='bodies' solves bodies and joints color by color, without "
                f"{' and '.join(found)}, which this model has. Leave parallel out."
            )
        return not found

    def _group_worlds(self) -> None:
        """Decides which bodies one thread solves, and with which effects.

        A group is a Newton world, or, where global bodies that move tie the worlds together, all
        bodies at once. With error control any global body does.
        """
        groups, topology, self._flags, self._callers = self._look_at_model(self._solved)
        self._make_actuation(topology)
        self._make_limit_law()
        self._flags_apart = self._flags.without_contact()
        self._allocate_body_effects(topology)
        if not self._flags.put_bodies and self._work.put is not None:
            self._work.put_from.zero_()
        if self._flags.dahl and self._history.dahl_sigma is None:
            self._forget_launches()
            with wp.ScopedDevice(self.device):
                buffers.add_dahl_history(self._history, self._solved)
        if self._capacity:
            self._allocate_contact_effects()
        if not self._flags.axis_rates and self._history.axis_velocity is not None:
            self._history.axis_velocity.fill_(UNKNOWN)
        is_large = self._takes_bodies(groups, self._flags)
        # one kernel makes the whole step of a single world, where launches cost most
        is_special = is_large or self._flags.sleeping or self._flags.reaction
        is_special |= self._flags.welds and self._flags.breaking
        self._at_once = self.device.is_cpu and not (is_special or groups.any())
        if topology == self._topology and is_large == (self._large is not None):
            self._allocate_runge_kutta()
            self._bind_tendons()
            return
        if self._topology is not None:
            self._forget_contacts()
            # graphs that were captured before go on using the old arrays
            self._retired.append((self._worlds, self._history.parity))
            self._retired.append((self._history.filling, self._history.step, self._history.age))
            self._retired.append((self._tree, self._loops, self._history.smooth))
            self._retired.append((self._history.loop_force, self._history.loop_torque))
            self._retired.append((self._history.loop_rate,))
        self._forget_launches()
        self._topology = topology
        self._world_count = int(groups.max(initial=0)) + 1
        with wp.ScopedDevice(self.device):
            self._worlds = buffers.world_work(
                topology, self.settings.second_order, self._flags.on_gpu
            )
            # bodies that would be grouped otherwise, and joints held, if these bodies moved
            self._taken_as_fixed = wp.array(
                topology.idle | (groups == self._solved.world_count), dtype=wp.bool
            )
            buffers.add_world_history(self._history, self._world_count, self.settings.second_order)
            if self._flags.adaptive:
                assert self.settings.accuracy is not None
                self._worlds.inner = inner_steps.inner_work(
                    self.settings.accuracy,
                    self.settings.inner_steps,
                    self._solved,
                    groups,
                    pushing_joints(self._solved),
                )
                slots = self._solved.body_count + 1
                inner_steps.add_history(self._history, slots, self._world_count)

        self._retired.append((self._large,))
        self._large, self._colors = None, None
        self._allocate_piles()
        self._allocate_trees(topology)
        self._allocate_runge_kutta()
        self._allocate_loops(topology, groups)
        self._allocate_closures(topology)
        self._allocate_cables(topology)
        self._bind_tendons()
        if is_large:
            self._large = LargeWorlds(
                self._worlds,
                self._loops,
                topology,
                0 if self._cables is None else self._cables.work.size.size,
                self.iterations,
                self.device,
            )
            self._colors = self._large.colors
        if self._capacity:
            self._allocate_large_contacts()
        self._allocate_sleep()

    def _allocate_body_effects(self, topology: Topology) -> None:
        """Buffers by body slot that only some effects need, where they are not there yet."""
        effects, work, islands, history = self._flags, self._work, self._islands, self._history
        is_carried, has_free = effects.carried_rounding, bool(np.any(topology.is_alone))
        by_body: tuple[tuple[bool, Any, tuple[str, ...]], ...] = (
            (effects.put_bodies, work, ("put", "put_from")),
            (effects.drag, work, ("drag",)),
            (effects.pairs, islands, ("hold_ll", "hold_al")),
            (effects.balanced, islands, ("balance", "start_q", "start_qd")),
            (is_carried, work, ("gained",)),
            (is_carried and effects.joints, work, ("rounded",)),
            (is_carried and effects.joints, history, ("lost_turn",)),
            (is_carried and has_free, history, ("flights",)),
        )
        for is_wanted, owner, names in by_body:
            if is_wanted and getattr(owner, names[0]) is None:
                self._forget_launches()
                with wp.ScopedDevice(self.device):
                    data.allocate(owner, self._solved.body_count + 1, *names)

    def _allocate_piles(self) -> None:
        """Buffers for the piles of free bodies."""
        if self._flags.piles:
            slots = self._solved.body_count + 1
            count = slots if self.settings.sleeping else self._world_count
            with wp.ScopedDevice(self.device):
                self._rows.piles = buffers.pile_work(slots, count)
        self._work.mixed = None
        if self._flags.mixing:
            slots = self._solved.body_count + 1
            self._work.mixed = wp.zeros(slots, dtype=data.MixedBody, device=self.device)

    def _allocate_trees(self, topology: Topology) -> None:
        """Buffers for the trees of joints."""
        self._tree = data.TreeWork()
        if self._flags.joints:
            with wp.ScopedDevice(self.device):
                self._tree = buffers.tree_work(self._solved, topology)
                if self._history.joint_force is None:
                    buffers.add_joint_history(self._history, self._solved, self._rest_angle)

    def _allocate_runge_kutta(self) -> None:
        """Buffers for the stages of steps of fourth order, where there are none yet."""
        if self._flags.fourth_order and self._tree.runge_kutta.is_known is None:
            self._forget_launches()
            slots, axes = self._solved.body_count + 1, self._tree.axes.size
            with wp.ScopedDevice(self.device):
                self._tree.runge_kutta = buffers.runge_kutta_work(slots, axes, self._world_count)

    def _allocate_loops(self, topology: Topology, groups: np.ndarray) -> None:
        """Buffers for the joints outside of trees."""
        self._loops = data.LoopWork()
        if self._flags.loops:
            with wp.ScopedDevice(self.device):
                self._loops = buffers.loop_work(self._solved, topology, groups)
                count = topology.loops.size
                data.allocate(self._history, count, "loop_force", "loop_torque")
                if self._flags.yielding:
                    buffers.add_yielding(self._loops, topology)
                    data.allocate(self._history, count, "loop_rate")

    def _allocate_closures(self, topology: Topology) -> None:
        """Buffers for the equations that are solved with trees."""
        if self._flags.closures:
            joints = self._loops.joints.numpy().tolist() if self._flags.loops else []
            with wp.ScopedDevice(self.device):
                buffers.add_closures(self._tree.closures, topology, joints)

    def _allocate_cables(self, topology: Topology) -> None:
        """Buffers for Newton's tendons."""
        # graphs that were captured before go on using the old arrays
        self._retired.append((self._cables,))
        self._cables = None
        if self._flags.cables:
            self._cables = Cables(self.model, self._solved, self._welds, topology, self._launch)
            self._tree.cables = self._cables.work

    def _allocate_sleep(self) -> None:
        """Buffers for what sleeps; all bodies are awake afterwards."""
        if not self._flags.sleeping:
            return
        # graphs that were captured before go on using the old arrays
        self._retired.append((self._sleep, self._worlds.island, self._worlds.pace))
        self._retired.append((self._rows.awake, self._rows.awake_count))
        self._retired.append((self._seen_worlds, self._seen_history))
        model, topology = self._solved, self._topology
        assert topology is not None
        slots, capacity = model.body_count + 1, self._capacity
        with wp.ScopedDevice(self.device):
            island = np.append(np.full(slots - 1, AWAKE), STILL)
            data.fill(self._worlds, island=island)
            data.allocate(self._worlds, self._world_count, "pace")
            data.allocate(self._rows, capacity, "awake")
            data.allocate(self._rows, 1, "awake_count")
            self._sleep = buffers.sleep_work(
                model, topology, self._flags, capacity, self._loops, self._tree
            )
            self._seen_worlds, self._seen_history = buffers.seen_work(
                slots, self._world_count, self.settings.second_order
            )
        self._forget_launches()

    @property
    def _sides(self) -> int:
        """Of what is kept of contacts: a step reads one and writes another."""
        return buffers.SIDES if self.settings.accuracy is None else inner_steps.SIDES

    def _list_memory(self) -> None:
        """Lists what a step overwrites and a repeated one puts back, where arrays are new."""
        self._is_listed = True
        memory = inner_steps.overwritten(self._remembered())
        found = [(name, array.ptr) for name, array in memory]
        if found == self._listed:
            return
        if self.device.is_capturing:
            raise RuntimeError(
                "SolverAVBD(accuracy=...) has to take a step before this one is captured in a "
                "graph: the model has changed."
            )
        inner, groups = self._worlds.inner, self._solver_worlds(self._solved)
        # graphs that were captured before go on using the old arrays
        self._retired.append((inner.first, inner.segments, inner.store))
        assert self._topology is not None
        loops = self._loops.joints.numpy() if self._flags.loops else np.zeros(0, dtype=int)
        with wp.ScopedDevice(self.device):
            inner_steps.add_memory(
                inner,
                memory,
                self._solved,
                self._topology,
                groups,
                loops,
                self._tree.tendons,
                self._world_count,
            )
        self._launch.forget()
        self._listed = found

    def _forget_launches(self) -> None:
        """Drops what was packed, after a struct changed its arrays."""
        self._is_listed = False
        self._launch.forget()
        self._whole, self._seen = None, None
        self._steps.clear()

    def _context(self) -> data.Context:
        """What the kernels see of the solver."""
        if self._whole is None:
            links = self._solved.links if isinstance(self._solved, SolvedModel) else None
            self._whole = data.Context(
                self._bodies,
                self._shapes,
                self._joints,
                links,
                self._worlds,
                self._work,
                self._rows,
                self._tree,
                self._loops,
                self._islands,
                self._history,
                self._colors,
                self._sleep,
            )
        return self._whole

    def _seen_context(self) -> data.Context:
        """The same as the solve sees it: with sleeping, islands that are awake are its worlds."""
        if self._seen is None:
            seen = self._context()
            if self._flags.sleeping:
                worlds = data.merged(seen.worlds, self._seen_worlds)
                history = data.merged(seen.history, self._seen_history)
                seen = seen._replace(worlds=worlds, history=history)
            if self._flags.sleeping and self._flags.loops:
                loops = data.merged(seen.loops)
                loops.world_start = self._sleep.seen_loop_start
                seen = seen._replace(loops=loops)
            if self._flags.sleeping and self._flags.closures:
                tree = data.merged(seen.tree)
                tree.closures.block_of = self._sleep.seen_block_of
                seen = seen._replace(tree=tree)
            self._seen = seen
        return self._seen

    def _step_of(self, given: Any, result: Any, control: Any, contacts: Any, dt: float) -> Any:
        """What the kernels see of a step; made once for the same arguments."""
        arguments = [
            given.body_q,
            given.body_qd,
            given.body_f,
            control,
            contacts,
            result.body_q,
            result.body_qd,
        ]
        key = (*map(id, arguments), dt, self.iterations, self.tolerance)
        known = self._steps.get(key)
        if known is None:
            known = self._steps[key] = self._new_step(arguments, dt)
        return known[0]

    def _new_step(self, arguments: list, dt: float) -> tuple[Any, list]:
        """A step with these arguments, of the oldest one where there are enough.

        Launches see what a struct holds that they were given, also where it has changed since.
        """
        if len(self._steps) < _STEPS:
            step, before = data.Step(), [None] * len(arguments)
        else:
            step, before = self._steps.pop(next(iter(self._steps)))
        for name, value, old in zip(_GIVEN, arguments, before, strict=True):
            if value is not old:
                setattr(step, name, value)
        step.h, step.iterations, step.tolerance = dt, self.iterations, self.tolerance
        # what is named by its id has to stay
        return step, arguments

    def _allocate_contacts(self, capacity: int) -> None:
        """Buffers by contact. Nothing in them needs a start value: what is live is kept by body."""
        capture = self.device.is_capturing
        if capture and (self._capacity or self.device.is_cuda):
            raise RuntimeError(
                f"SolverAVBD needs buffers for {capacity} contacts, which cannot be allocated "
                "while a graph is captured: create the collision pipeline before the solver, or "
                "take one step with these contacts first."
            )
        if self._capacity:
            self._forget_contacts()
            self._history.age.zero_()
            self._history.filling.zero_()
            # graphs that were captured before go on using the old arrays
            self._retired.append((self._rows.rows, self._rows.owner, self._rows.contacts))
            self._retired.append((self._rows.other_rows,))
            self._retired.append((self._history.records, self._history.row_of_contact))
        self._capacity = capacity
        with wp.ScopedDevice(self.device):
            self._rows.owner = wp.empty(capacity, dtype=wp.int32)
            self._rows.contacts = wp.empty(capacity, dtype=wp.int32)
            self._rows.rows = wp.empty(capacity, dtype=data.ContactRow)
            self._rows.other_rows = wp.empty(capacity, dtype=wp.int32)
            if self._flags.on_gpu:
                size = scratch_size(self._solved.body_count)
                self._rows.sums = wp.empty(size, dtype=wp.int32)
            # what sleeps keeps its records beyond those of the rows
            room = 2 * capacity if self.settings.sleeping else capacity
            self._history.records = wp.empty((self._sides, room), dtype=data.ContactRecord)
            self._history.row_of_contact = wp.empty((self._sides, capacity), dtype=wp.int32)
        self._allocate_large_contacts()
        self._allocate_contact_effects()
        self._allocate_sleep()

    def _allocate_large_contacts(self) -> None:
        """Buffers by contact of a large world."""
        if self._large is not None:
            self._retired.append(self._large.allocate_contacts(self._capacity))
            self._retired.append((self._rows.other_rows,))
            size = 2 * self._capacity
            self._rows.other_rows = wp.empty(size, dtype=wp.int32, device=self.device)

    def _allocate_contact_effects(self) -> None:
        """Buffers by contact that only some effects need, where they are missing or too small."""
        effects, rows, history = self._flags, self._rows, self._history
        by_contact: tuple[tuple[Any, str, bool], ...] = (
            (rows, "drift", self._moving_surfaces or effects.drift),
            (rows, "left", effects.recovers_by_duals),
            (rows, "impacts", effects.restitution),
            (rows, "mixed", effects.mixing),
            (rows, "spin", effects.angular_friction),
            (history, "torque", effects.angular_friction),
            (rows, "share", effects.compliance),
            (rows, "stiffness", effects.ramp),
            (rows, "damping", effects.ramp),
            (self._worlds.inner, "contact_f", effects.adaptive),
        )
        with wp.ScopedDevice(self.device):
            for owner, name, is_wanted in by_contact:
                old = getattr(owner, name)
                of_history = owner is history
                room = self._history.records.shape[1] if of_history else self._capacity
                if is_wanted and (old is None or old.shape[-1] < room):
                    # graphs that were captured before go on using the old array
                    self._retired.append((old,))
                    data.allocate(owner, (self._sides, room) if of_history else room, name)
            if effects.restitution and rows.struck_qd is None:
                data.allocate(rows, self._solved.body_count + 1, "struck_qd", "struck_at")
        self._forget_launches()

    def _forget_contacts(self) -> None:
        """Drops all multipliers and rows, on the device."""
        if self._capacity:
            for array in (
                self._history.start,
                self._history.end,
                self._rows.owned_start,
                self._rows.owned_end,
            ):
                array.zero_()

    def _contact_input(self, contacts: newton.Contacts) -> data.ContactInput:
        """What the kernels see of a contact buffer; made once for each buffer."""
        source = self._inputs.get(contacts)
        if source is not None:
            return source
        surfaces = contacts.rigid_contact_surface_velocity
        if "moving_surfaces" in self._without:
            surfaces = None
        new_surfaces = surfaces is not None and not self._moving_surfaces
        if contacts.rigid_contact_max > self._capacity or new_surfaces:
            self._moving_surfaces |= new_surfaces
            self._allocate_contacts(max(contacts.rigid_contact_max, self._capacity))
        for name in (*_CONTACT_ARRAYS, *_EXTRA_CONTACT_ARRAYS):
            array = getattr(contacts, f"rigid_contact_{name}")
            if array is not None or name in _CONTACT_ARRAYS:
                count = contacts.rigid_contact_max
                check_array(f"contacts.rigid_contact_{name}", array, count, self.device)
        self._buffer_count += 1
        source = views.contact_input(contacts, self._buffer_count, surfaces)
        self._inputs[contacts] = source
        return source

    def _control_input(self, source: newton.Control | newton.Model) -> data.ControlInput:
        """What the kernels see of the control; made anew only where its arrays are others."""
        arrays = (source.joint_f, source.joint_target_q, source.joint_target_qd)
        if all(a is b for a, b in zip(arrays, self._control_arrays, strict=True)):
            return self._control
        for name in ("joint_f", "joint_target_q", "joint_target_qd") if self._flags.joints else ():
            count = getattr(self._solved, name).shape[0]
            check_array(f"control.{name}", getattr(source, name), count, self.device)
        self._control_arrays = arrays
        self._control = data.ControlInput()
        if self._actuation is not None:
            self._control.pushes = self._actuation.pushes
            self._control.ranged = self._actuation.ranged
        if arrays[0] is not None:
            self._control.joint_f = arrays[0]
        if arrays[1] is not None:
            self._control.target_q, self._control.target_qd = arrays[1], arrays[2]
        return self._control

    def _actuator_control(self, source: newton.Control | None) -> wp.array | None:
        """Controls of MuJoCo's actuators."""
        assert self._actuation is not None
        count = self._actuation.control_count
        if count == 0:
            return None
        namespace = getattr(self.model if source is None else source, "mujoco", None)
        ctrl = getattr(namespace, "ctrl", None)
        if ctrl is None:
            raise ValueError(
                "control has no mujoco.ctrl, which the model's actuators need. Create it with "
                "model.control()."
            )
        if ctrl is not self._ctrl:
            is_array = isinstance(ctrl, wp.array)
            if not is_array or ctrl.shape != (count,) or ctrl.dtype != wp.float32:
                given = f"{ctrl.dtype.__name__} of shape {ctrl.shape}" if is_array else type(ctrl)
                raise ValueError(
                    f"control.mujoco.ctrl must be a Warp array of {count} numbers of float32, one "
                    f"an actuator, in the order of the model's mujoco:actuator rows, as "
                    f"model.control() makes it; it is {given}. Write to that array by assign()."
                )
            check_array("control.mujoco.ctrl", ctrl, count, self.device)
            self._ctrl = ctrl
        return ctrl

    def _make_limit_law(self) -> None:
        """What MuJoCo's law of compliant limits takes, or where margins put rigid ones."""
        # graphs that were captured before go on using the old arrays
        self._retired.append((self._limit_law,))
        if self._flags.limit_impedance:
            acting = self._actuation
            beside = None if acting is None else acting.tendon_inertia
            self._limit_law = limit_law(self.model, beside)
        elif self._flags.limits and not self._flags.compliance:
            self._limit_law = limits_within_margins(self.model)
        else:
            self._limit_law = {}
        if self._solved.joint_count:
            self._joints.limit_lower = self._solved.joint_limit_lower
            self._joints.limit_upper = self._solved.joint_limit_upper
        for name, values in self._limit_law.items():
            setattr(self._joints, name, values)

    def _bind_tendons(self) -> None:
        """Points the kernels to the tendons that actuators pull."""
        if self._actuation is not None and self._flags.tendons:
            self._tree.tendons = self._actuation.tendons
            self._forget_launches()

    def _make_actuation(self, topology: Topology) -> None:
        """Buffers for MuJoCo's actuators, tendons and gravity compensation, where there are any."""
        if self._solved.joint_count:
            self._joints.armature = self._solved.joint_armature
            self._joints.target_mode = self._solved.joint_target_mode
        names = (*ACTING, "effort_limits", "force_ranges", "compliance", "second_order")
        wanted = frozenset(name for name in names if getattr(self._flags, name))
        before, self._actuation, self._ctrl = self._actuation, None, None
        # graphs that were captured before go on using the old arrays
        self._retired.append((before, self._actuator_force))
        self._actuator_force = None
        if not wanted.isdisjoint(ACTING):
            self._actuation = Actuation(
                self.model, self._solved, topology, self._joints, wanted, self._activations, before
            )
            self._actuation.bind(self._joints, self._bodies)
        # the next step makes its view of the control anew
        self._control_arrays = (None, None, None)

    def _flags_with(self, contacts: newton.Contacts | None) -> Effects:
        """The scene's effects, with those that a contact buffer adds."""
        if contacts is None:
            # kernels of a large world are many, and find no contacts in no time
            return self._flags_apart if self._large is None else self._flags
        # large worlds find contacts again by their anchors
        matching = contacts.rigid_contact_match_index is not None and self._large is None
        surfaces = contacts.rigid_contact_surface_velocity is not None
        materials = contacts.rigid_contact_friction is not None
        if not (matching or surfaces or materials):
            return self._flags
        return dataclasses.replace(
            self._flags, matching=matching, moving_surfaces=surfaces, contact_materials=materials
        ).leaving_out(self._without)

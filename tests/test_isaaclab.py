# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Isaac Lab selects SolverAVBD by configuration.

Isaac Lab 3.0.0 pins Newton 1.6.1, so that a stand-in with its names, signatures and order of calls
takes its place. They are those of the package isaaclab_newton in release 3.0.0 (commit 02e6839 of
github.com/isaac-sim/IsaacLab has that version; its page "Extending Newton Solvers" states the
contract), and of the development branch after it (newton_manager.py of commit 9aa79e7, and
newton_solver.py of commit bb013b4).
"""

import dataclasses
import importlib
import inspect
import re
import runpy
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import newton
import newton.actuators
import newton.examples
import numpy as np
import pytest
import warp as wp
from newton.actuators import ClampingDCMotor, DrivePD
from newton.solvers import SolverBase

from newton_avbd import SolverAVBD

EXAMPLES = Path(__file__).parent.parent / "examples" / "isaaclab"
PAGE = Path(__file__).parent.parent / "docs" / "isaaclab.md"
DT = 1.0 / 120.0


def configclass(cls: type) -> type:
    """What Isaac Lab's decorator is to its users: a dataclass with ``to_dict``."""
    made = dataclasses.dataclass(cls)
    made.to_dict = dataclasses.asdict
    return made


@pytest.fixture
def lab(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Modules in the place of Isaac Lab's, with a manager of both versions."""

    class NewtonManager:
        _solver: Any = None
        _use_single_state = True
        _needs_collision_pipeline = False
        _supports_rigid_body_force_input = False

        @staticmethod
        def _filter_solver_kwargs(solver_cls: type, solver_cfg: Any) -> dict[str, Any]:
            valid = set(inspect.signature(solver_cls.__init__).parameters) - {"self", "model"}
            return {key: value for key, value in solver_cfg.to_dict().items() if key in valid}

        @classmethod
        def create_solver(cls, model: newton.Model, solver_cfg: Any) -> Any:
            return cls.solver_class(
                model, **cls._filter_solver_kwargs(cls.solver_class, solver_cfg)
            )

    @configclass
    class NewtonSolverCfg:
        class_type: type | str = "{DIR}.newton_manager:NewtonManager"
        solver_type: str = "None"

    @configclass
    class NewtonCfg:
        solver_cfg: Any = None
        num_substeps: int = 1

        def __post_init__(self) -> None:
            module, _, name = self.solver_cfg.class_type.partition(":")
            self.class_type = getattr(importlib.import_module(module), name)

    @dataclasses.dataclass
    class TaskCfg:
        sim: Any = dataclasses.field(default_factory=SimpleNamespace)

        def __post_init__(self) -> None:
            self.sim.physics = "its own"

    contents: dict[str, dict[str, Any]] = {
        "isaaclab": {},
        "isaaclab.utils": {},
        "isaaclab.utils.configclass": {"configclass": configclass},
        "isaaclab_newton": {},
        "isaaclab_newton.physics": {
            "NewtonManager": NewtonManager,
            "NewtonSolverCfg": NewtonSolverCfg,
            "NewtonCfg": NewtonCfg,
        },
    }
    tasks = {
        "isaaclab_tasks.core.cartpole.cartpole_direct_env_cfg": "CartpoleEnvCfg",
        "isaaclab_tasks.core.velocity.config.go2.flat_env_cfg": "UnitreeGo2FlatEnvCfg",
    }
    for path, name in tasks.items():
        parts = path.split(".")
        contents |= {".".join(parts[:length]): {} for length in range(1, len(parts))}
        contents[path] = {name: TaskCfg}
    for name, members in contents.items():
        module = ModuleType(name)
        vars(module).update(members)
        monkeypatch.setitem(sys.modules, name, module)
    for name in ("config", "manager"):
        monkeypatch.delitem(sys.modules, f"newton_avbd.isaaclab.{name}", raising=False)
    yield SimpleNamespace(**contents["isaaclab_newton.physics"])
    for name in ("config", "manager"):
        sys.modules.pop(f"newton_avbd.isaaclab.{name}", None)


def cartpoles(solver_class: type) -> newton.Model:
    """Two worlds with a cartpole in each, built as the manager's builder is."""
    cartpole = newton.ModelBuilder()
    solver_class.register_custom_attributes(cartpole)
    cartpole.add_urdf(newton.examples.get_asset("cartpole.urdf"), floating=False)
    scene = newton.ModelBuilder()
    for _ in range(2):  # Isaac Lab registers on a prototype and on the scene, maybe twice
        solver_class.register_custom_attributes(scene)
    scene.replicate(cartpole, 2)
    return scene.finalize(device="cpu")


def swing(solver: SolverAVBD, *, reset_first: bool) -> np.ndarray:
    """Joint coordinates [m, rad] as Isaac Lab steps, with a reset of world 1 half-way.

    Args:
        solver: The solver.
        reset_first: Whether the solver is reset before bodies are put where the task has written
            joint coordinates; the two versions differ in that.
    """
    model = solver.model
    states = [model.state(), model.state()]
    q = np.array(model.joint_q.numpy().reshape(2, -1))
    q[:, 1] = 0.3
    states[0].joint_q.assign(q.ravel())
    newton.eval_fk(model, states[0].joint_q, states[0].joint_qd, states[0])
    control = model.control()
    for step in range(40):
        if step == 20:
            written = np.array(states[0].joint_q.numpy().reshape(2, -1))
            rates = np.array(states[0].joint_qd.numpy().reshape(2, -1))
            written[1], rates[1] = q[1], 0.0
            states[0].joint_q.assign(written.ravel())
            states[0].joint_qd.assign(rates.ravel())
            mask = wp.array([False, True, False], dtype=wp.bool, device=model.device)
            if reset_first:
                solver.reset(states[0], world_mask=mask, flags=0)
            newton.eval_fk(model, states[0].joint_q, states[0].joint_qd, states[0])
            if not reset_first:
                solver.reset(states[0], world_mask=mask, flags=0)
        states[0].clear_forces()
        solver.step(states[0], states[1], control, None, DT)
        states.reverse()
        if step == 19:
            before = states[0].joint_q.numpy().reshape(2, -1)[0].copy()
    coordinates = states[0].joint_q.numpy().reshape(2, -1)
    # World 1 began anew after 20 steps: it is where world 0 was then.
    np.testing.assert_allclose(coordinates[1], before, atol=2.0e-6)
    return coordinates.copy()


@pytest.mark.filterwarnings("ignore:SolverAVBD steps without contacts")
def test_the_configuration_selects_the_solver(lab: Any) -> None:
    from newton_avbd.isaaclab import AVBDSolverCfg

    physics = lab.NewtonCfg(solver_cfg=AVBDSolverCfg(iterations=7))
    manager = physics.class_type
    assert manager.__name__ == "NewtonAVBDManager" and issubclass(manager, lab.NewtonManager)

    # Release 3.0.0: slots of the base class.
    (registered,) = manager._builder_attribute_solvers
    model = cartpoles(registered)
    manager._build_solver(model, physics.solver_cfg)
    slots = lab.NewtonManager
    assert type(slots._solver) is SolverAVBD
    assert slots._solver.iterations == 7
    assert not slots._use_single_state
    assert slots._needs_collision_pipeline and slots._supports_rigid_body_force_input

    # After it: the base class constructs.
    assert manager.builder_attribute_solvers == manager._builder_attribute_solvers
    later = manager.create_solver(model, physics.solver_cfg)

    first = swing(slots._solver, reset_first=True)
    np.testing.assert_array_equal(swing(later, reset_first=False), first)
    assert abs(first[0, 1] - 0.3) > 0.1  # it swings, and joint coordinates are written


@pytest.mark.filterwarnings("ignore:SolverAVBD steps without contacts")
def test_an_adapter_without_a_state_makes_the_solver(
    lab: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The last stage of the development branch: hooks that take a backend."""

    class NewtonSolver:
        solver_class: Any = None
        builder_attribute_solvers: tuple[type, ...] = ()

        @classmethod
        def create_solver(
            cls, model: newton.Model, solver_cfg: Any, deterministic_mode: Any = None
        ) -> Any:
            return cls.solver_class(
                model, **cls.solver_kwargs(cls.solver_class, solver_cfg, deterministic_mode)
            )

        @staticmethod
        def solver_kwargs(solver_cls: type, solver_cfg: Any, mode: Any) -> dict[str, Any]:
            valid = set(inspect.signature(solver_cls.__init__).parameters) - {"self", "model"}
            assert "deterministic" not in valid
            return {key: value for key, value in solver_cfg.to_dict().items() if key in valid}

    module = sys.modules["isaaclab_newton.physics"]
    monkeypatch.setattr(module, "NewtonSolver", NewtonSolver, raising=False)
    from newton_avbd.isaaclab import AVBDSolverCfg

    settings = AVBDSolverCfg(iterations=7)
    adapter = lab.NewtonCfg(solver_cfg=settings).class_type
    assert issubclass(adapter, NewtonSolver) and not issubclass(adapter, lab.NewtonManager)
    (registered,) = adapter.builder_attribute_solvers
    solver = adapter.create_solver(cartpoles(registered), settings)
    assert type(solver) is SolverAVBD and solver.iterations == 7
    assert abs(swing(solver, reset_first=True)[0, 1] - 0.3) > 0.1


def test_every_setting_is_an_argument_of_the_solver(lab: Any) -> None:
    from newton_avbd.isaaclab import AVBDSolverCfg

    settings = set(AVBDSolverCfg().to_dict()) - {"class_type", "solver_type"}
    assert settings <= set(inspect.signature(SolverAVBD.__init__).parameters)


@pytest.mark.parametrize("script", sorted(EXAMPLES.glob("*.py")), ids=lambda script: script.stem)
def test_an_example_gives_its_task_the_solver(
    lab: Any, script: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    gymnasium = pytest.importorskip("gymnasium")
    registered: dict[str, Any] = {}
    monkeypatch.setattr(gymnasium, "register", lambda **options: registered.update(options))
    names = runpy.run_path(str(script))
    config = names[registered["kwargs"]["env_cfg_entry_point"].rpartition(":")[2]]()
    assert config.sim.physics.class_type.__name__ == "NewtonAVBDManager"


def test_the_code_of_the_page_selects_the_solver(lab: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Blocks of docs/isaaclab.md, in their order; one gives Newton names, which go after it."""
    monkeypatch.setattr(newton.actuators, "Clamping", None, raising=False)
    for kind in ("cloth", "soft"):
        for part in ("label", "particle_start", "particle_end"):
            monkeypatch.setattr(newton.ModelBuilder, f"_{kind}_{part}", None, raising=False)
    names: dict[str, Any] = {"__name__": "__main__"}
    for block in re.findall(r"^```python\n(.*?)^```$", PAGE.read_text(), re.MULTILINE | re.DOTALL):
        exec(block, names)
    for physics in (names["physics"], names["AVBDCartpoleEnvCfg"]().sim.physics):
        assert physics.class_type.__name__ == "NewtonAVBDManager"


def quadruped(solver_class: type) -> newton.Model:
    """A robot of the size of Unitree's Go2 above flat ground, as the task's configuration has it.

    The configuration is UNITREE_GO2_CFG (unitree.py of commit 022008d): start 0.4 m above the
    ground, hips at 0.1 rad outwards, thighs at 0.8 and 1.0 rad, calves at -1.5 rad; DC motors of
    25 N m/rad, 0.5 N m s/rad, 23.5 N m and 30 rad/s, as actuators of Newton. Its description lies
    on a server, so sizes and masses are those of the robot's data sheet, and bodies boxes.
    """
    builder = newton.ModelBuilder()
    solver_class.register_custom_attributes(builder)
    skin = newton.ModelBuilder.ShapeConfig(density=0.0, mu=0.8)

    def link(mass: float, size: tuple[float, float, float], down: float = 0.0) -> int:
        """A box of this mass [kg] and size [m], whose center is so far below its joint [m]."""
        x, y, z = np.square(size)
        inertia = wp.mat33(np.diag([y + z, x + z, x + y]).astype(np.float32) * mass / 12.0)
        return builder.add_link(mass=mass, inertia=inertia, com=(0.0, 0.0, -down))

    base = link(6.9, (0.38, 0.094, 0.114))
    builder.add_shape_box(base, hx=0.19, hy=0.047, hz=0.057, cfg=skin)
    joints = [builder.add_joint_free(base)]
    for front in (1.0, -1.0):
        for left in (1.0, -1.0):
            parts = [
                (link(0.68, (0.1, 0.05, 0.1)), (0.193 * front, 0.047 * left, 0.0), (1.0, 0.0, 0.0)),
                (link(1.15, (0.03, 0.03, 0.213), 0.05), (0.0, 0.0955 * left, 0.0), (0.0, 1.0, 0.0)),
                (link(0.24, (0.02, 0.02, 0.213), 0.12), (0.0, 0.0, -0.213), (0.0, 1.0, 0.0)),
            ]
            rests = (0.1 * left, 0.8 if front > 0.0 else 1.0, -1.5)
            parent = base
            for (child, at, axis), rest in zip(parts, rests, strict=True):
                joint = builder.add_joint_revolute(
                    parent, child, parent_xform=wp.transform(at, wp.quat_identity()), axis=axis
                )
                coordinate, dof = builder.joint_q_start[joint], builder.joint_qd_start[joint]
                builder.joint_q[coordinate] = builder.joint_target_q[coordinate] = rest
                motor = {"saturation_effort": 23.5, "velocity_limit": 30.0}
                builder.add_actuator(
                    *(DrivePD, dof, [(ClampingDCMotor, motor | {"max_motor_effort": 23.5})]),
                    **{"pos_index": coordinate, "kp": 25.0, "kd": 0.5},
                )
                joints.append(joint)
                parent = child
            foot = wp.transform((0.0, 0.0, -0.213), wp.quat_identity())
            builder.add_shape_sphere(parent, xform=foot, radius=0.022, cfg=skin)
    builder.add_articulation(joints)
    builder.joint_q[2] = 0.4
    builder.add_ground_plane()
    return builder.finalize(device="cpu")


def test_the_quadruped_of_the_example_stands(lab: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Three seconds of actions of zero, each held for four steps of 5 ms, as the task steps."""
    gymnasium = pytest.importorskip("gymnasium")
    monkeypatch.setattr(gymnasium, "register", lambda **options: None)
    config = runpy.run_path(str(EXAMPLES / "quadruped.py"))["AVBDGo2FlatEnvCfg"]()
    manager = config.sim.physics.class_type
    model = quadruped(manager.solver_class)
    solver = manager.create_solver(model, config.sim.physics.solver_cfg)
    pipeline = newton.CollisionPipeline(model)
    contacts = pipeline.contacts()
    state, after, control = model.state(), model.state(), model.control()
    observables = solver.observables({SolverBase.ObservableKind.CONTACT_F}, contacts=contacts)
    newton.eval_fk(model, state.joint_q, state.joint_qd, state)
    mass, support = model.body_mass.numpy().sum(), 0.0
    for step in range(600):
        if step == 400:
            rising = model.body_mass.numpy() @ state.body_qd.numpy()[:, 2]
        control.joint_f.zero_()
        for actuator in model.actuators:
            actuator.step(state, control, dt=0.005)
        pipeline.collide(state, contacts)
        solver.step(state, after, control, contacts, 0.005, observables=observables)
        state, after = after, state
        if step >= 400:
            support += 0.005 * np.abs(observables.contact_f.numpy()[:, 2].sum())
    # Over the last second the ground gives the weight and the change of momentum.
    change = model.body_mass.numpy() @ state.body_qd.numpy()[:, 2] - rising
    assert support == pytest.approx(mass * 9.81 + change, rel=1.0e-4)
    # As stiff legs stand at 0.33 m; motors of 25 N m/rad give way by some 0.2 rad.
    x, y, z, *rotation = state.joint_q.numpy()[:7]
    assert 0.24 < z < 0.33
    assert np.hypot(rotation[0], rotation[1]) < 0.1  # half of the tilt [rad]
    # Left and right are alike, and the solver is, too: rounding of 3e-8 m a step, 600 of them.
    assert abs(y) < 3.0e-6
    assert abs(x) < 0.25
    assert np.abs(control.joint_f.numpy()).max() < 23.5


def test_without_isaac_lab_the_error_says_what_to_install() -> None:
    module = importlib.import_module("newton_avbd.isaaclab")
    for name in module.__all__:
        with pytest.raises(ImportError, match=r"needs Isaac Lab 3\.0"):
            getattr(module, name)

# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Isaac Lab selects SolverAVBD by configuration.

Isaac Lab 3.0.0 pins Newton 1.6.1, so that a stand-in with its names, signatures and order of calls
takes its place. They are those of the package isaaclab_newton in release 3.0.0 (commit 02e6839 of
github.com/isaac-sim/IsaacLab has that version; its page "Extending Newton Solvers" states the
contract), and of the development branch after it (newton_manager.py of commit 9aa79e7).
"""

import dataclasses
import importlib
import inspect
import runpy
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import newton
import newton.examples
import numpy as np
import pytest
import warp as wp

from newton_avbd import SolverAVBD

EXAMPLES = Path(__file__).parent.parent / "examples" / "isaaclab"
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


def test_without_isaac_lab_the_error_says_what_to_install() -> None:
    module = importlib.import_module("newton_avbd.isaaclab")
    for name in module.__all__:
        with pytest.raises(ImportError, match=r"needs Isaac Lab 3\.0"):
            getattr(module, name)

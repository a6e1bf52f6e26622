"""The FMU of a learned controller plans what Python plans, with its online filter."""

import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from stepgap.experiment.deployment import tracking_plan
from stepgap.export.controller.fmu import COMPILERS, controller_fmu
from stepgap.export.controller.portable_controller import PortableController
from stepgap.step import Array, StepRecord, StepStatus
from tests.export.controller.learned import SPACE, learned

fmpy = pytest.importorskip("fmpy", reason="FMPy is not installed")
pytestmark = pytest.mark.skipif(not any(map(shutil.which, COMPILERS)), reason="there is no C compiler")
COUNT = 30


def inputs() -> np.ndarray[Any, Any]:
    """Measured states, targets and yaw angles, of a robot whose steps do not depend on its commands."""
    rng = np.random.default_rng(4)
    names = ["time", "state_speed", "state_height", "target_speed", "target_height", "phase"]
    rows = np.empty((COUNT + 1, 6))
    rows[:, 0] = np.arange(COUNT + 1)
    rows[:, 1:3] = SPACE.state_centre + SPACE.state_scale * rng.uniform(-0.5, 0.5, (COUNT + 1, 2))
    rows[:, 3:5] = SPACE.state_centre + SPACE.state_scale * rng.uniform(-0.2, 0.2, (COUNT + 1, 2))
    rows[:, 5] = np.cumsum(rng.uniform(0, 0.7, COUNT + 1))
    return np.array([tuple(row) for row in rows], dtype=[(name, float) for name in names])


def python_plans(controller: PortableController, rows: np.ndarray[Any, Any]) -> Array:
    """Command, prediction and standard deviation of every step, by the classes of Python; (COUNT, 6)."""
    table = np.array([list(row) for row in rows])
    beliefs, command, plans = controller.beliefs, None, []
    for k in range(COUNT):
        state, target, yaw = table[k, 1:3], table[k, 3:5], table[k, 5]
        if command is not None:
            before = StepRecord(table[k - 1, 1:3], command, command, state, StepStatus.OK)
            beliefs = controller.after(beliefs, before, table[k - 1, 5])
        present = controller.map_by(beliefs, yaw)
        plan = tracking_plan(replace(controller.controller, step_map=present), state, target, command)
        command = plan.command
        plans.append(np.concatenate([plan.command, plan.predicted, plan.std]))
    return np.array(plans)


def test_it_plans_what_python_plans_twice_in_a_row(tmp_path: Path) -> None:
    controller = learned("posterior")
    file = tmp_path / "controller.fmu"
    file.write_bytes(controller_fmu(controller))
    outputs = [f"{name}_{each.name}" for name, group in (
        ("command", SPACE.command), ("predicted", SPACE.state), ("std", SPACE.state)) for each in group]  # fmt: skip
    options: dict[str, Any] = {
        "start_values": {"phase_known": True}, "input": inputs(), "stop_time": float(COUNT), "step_size": 1.0,
        "output_interval": 1.0, "output": [*outputs, "result"],
    }  # fmt: skip
    first, second = (fmpy.simulate_fmu(str(file), **options) for _ in range(2))
    assert np.array_equal(first, second)
    found = np.array([[row[name] for name in outputs] for row in first[1:]])
    assert not first["result"].any()
    scale = np.concatenate([SPACE.command_scale, SPACE.state_scale, SPACE.state_scale])
    assert np.abs((found - python_plans(controller, inputs())) / scale).max() < 1e-6

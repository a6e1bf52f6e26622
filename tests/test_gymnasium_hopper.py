"""The example with Gymnasium's hopper: its dynamics are consistent, it hops with any commands, and it learns."""

# pyright: reportAttributeAccessIssue=false

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from stepgap.experiment.deployment import deploy
from stepgap.learning.learner import Learner
from stepgap.learning.settings import LearningSettings
from stepgap.learning.steps import Steps
from stepgap.mujoco_robots.mjcf.mjcf_gap import MjcfGap
from stepgap.mujoco_robots.mjcf.mjcf_robot import MjcfPlant, MjcfStepper
from stepgap.robots.nominal_maps.surrogate_map import fit_surrogate
from stepgap.robots.robot import stairs
from stepgap.step import StepStatus

pytest.importorskip("gymnasium")
EXAMPLE = Path(__file__).parents[1] / "examples" / "gymnasium_hopper"


@pytest.fixture(scope="module")
def robot() -> Iterator[Any]:
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(EXAMPLE)
        for name in ("gymnasium_hopper", "hopper_law"):
            patch.delitem(sys.modules, name, raising=False)
        import gymnasium_hopper  # pyright: ignore[reportMissingImports]

        yield gymnasium_hopper.GymnasiumHopper()


def test_the_model_is_gymnasiums_own_with_its_time_step(robot: Any) -> None:
    model = robot.mjcf_model()
    assert (model.nq, model.nu, model.opt.timestep) == (6, 3, 0.002)
    assert model.joint("rooty").limited[0] == 0, "the torso pitches freely"


def test_a_placed_robot_is_in_that_state(robot: Any) -> None:
    model = robot.mjcf_model()
    data, space = mujoco.MjData(model), robot.space
    for share in (-1.0, 0.0, 0.7):
        state = space.state_centre + share * space.state_scale
        mujoco.mj_resetData(model, data)
        robot.place(model, data, state)
        np.testing.assert_allclose(robot.state(model, data), state, atol=1e-9)
        sole = data.geom("foot_geom").xpos[2] - model.geom("foot_geom").size[0]
        assert sole == pytest.approx(0.0, abs=1e-9), "the foot touches the ground"


def test_it_hops_thirty_times_from_a_random_state_with_random_commands(robot: Any) -> None:
    space = robot.space
    rng = np.random.default_rng(11)
    stepper = MjcfStepper(robot, MjcfGap(), rng)
    stepper.place(space.state_centre + space.state_scale * rng.uniform(-1, 1, len(space.state)))
    for _ in range(30):
        assert stepper.step(space.command_at(rng.uniform(-1, 1, len(space.command)))) == StepStatus.OK


def test_it_learns_in_a_few_steps(robot: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    for limit in ("FIRST_SAMPLES", "MOST_SAMPLES"):
        monkeypatch.setattr(f"stepgap.robots.nominal_maps.surrogate_map.{limit}", 32)
    nominal = fit_surrogate(robot.nominal_maps()["simulator"](), np.random.default_rng(0))
    reference, log, errors = stairs(robot.space, steps=2), Steps(robot.space), []
    for iteration in range(2):
        learner = Learner.start(nominal, log, LearningSettings(), iteration)
        steps = list(deploy(learner, MjcfPlant(robot, np.random.default_rng(iteration)), reference, iteration))
        assert [logged.record.status for logged in steps] == [StepStatus.OK] * len(reference)
        log += steps
        error = np.array([logged.record.next_state - logged.predicted for logged in steps]) / robot.space.state_scale
        errors.append(np.sqrt(np.mean(error**2)))
    assert errors[1] < 0.7 * errors[0]

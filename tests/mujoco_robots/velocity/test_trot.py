"""The trot against kinematics of MuJoCo and symmetry; and that it walks as it is told, roughly, and does not fall."""

# pyright: reportAttributeAccessIssue=false

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from stepgap.mujoco_robots.mjcf.mjcf_robot import MjcfPlant
from stepgap.mujoco_robots.quadruped.model import LEGS, TOTAL_MASS
from stepgap.mujoco_robots.velocity.robot import TrottingRobot, joint_angles
from stepgap.mujoco_robots.velocity.walking_robot import WalkingGap
from stepgap.step import Array, StepStatus

ROBOT = TrottingRobot()
EXACT = replace(ROBOT, gap=WalkingGap.none())
RNG = np.random.default_rng(5)


def steady(robot: TrottingRobot, *command: float) -> Array:
    """Velocity after five steps."""
    plant = MjcfPlant(robot, np.random.default_rng(0))
    plant.start()
    records = [plant.take_step(np.array(command)) for _ in range(5)]
    assert {record.status for record in records} == {StepStatus.OK}
    return records[-1].next_state


def test_the_model_has_the_mass_of_its_parts() -> None:
    assert ROBOT.mjcf_model().body_mass.sum() == pytest.approx(TOTAL_MASS)


def test_the_angles_of_the_joints_place_the_feet() -> None:
    model = ROBOT.mjcf_model()
    data = mujoco.MjData(model)
    for _ in range(5):
        middle = np.array([[0.0, np.sign(leg.y) * 0.0955, -0.28] for leg in LEGS])
        feet = middle + RNG.uniform(-0.08, 0.08, (4, 3))
        data.qpos[7:] = joint_angles(feet)
        mujoco.mj_kinematics(model, data)
        hips = np.array([data.body(f"{leg.name}_hip").xpos for leg in LEGS])
        found = np.array([data.geom(f"{leg.name}_foot").xpos for leg in LEGS])
        np.testing.assert_allclose(found - hips, feet, atol=1e-12)
    assert np.isfinite(joint_angles(np.array([[0.0, 0.0, 0.0], [9, 9, 9], [0, 0, -9], [0, 0.01, 0.01]]))).all()


def test_it_stands_with_its_feet_on_the_ground() -> None:
    model = ROBOT.mjcf_model()
    data = mujoco.MjData(model)
    ROBOT.place(model, data, np.zeros(3))
    mujoco.mj_kinematics(model, data)
    for leg in LEGS:
        assert data.geom(f"{leg.name}_foot").xpos[2] == pytest.approx(0.022)


@pytest.mark.parametrize("command", [(0.0, 0.0, 0.0), (0.04, 0.0, 0.0), (0.0, 0.0, -0.1)])
def test_a_command_in_the_dead_band_is_not_walked(command: tuple[float, float, float]) -> None:
    np.testing.assert_allclose(steady(EXACT, *command), 0.0, atol=1e-3)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_it_walks_faster_the_faster_it_is_told(axis: int) -> None:
    """And misses the velocity: a robot without an error would show nothing."""
    commands = np.outer(np.array([-0.6, 0.3, 0.9]) * ROBOT.space.command_scale[axis], np.eye(3)[axis])
    found = np.array([steady(EXACT, *command) for command in commands])
    assert (np.diff(found[:, axis]) > 0.3 * np.diff(commands[:, axis])).all()
    assert np.abs(found - commands).max() > 0.05


def test_a_mirrored_command_is_a_mirrored_walk() -> None:
    left, right = steady(EXACT, 0.4, 0.2, 0.4), steady(EXACT, 0.4, -0.2, -0.4)
    np.testing.assert_allclose(left * [1, -1, -1], right, atol=0.03)


@pytest.mark.parametrize("number", range(3))
def test_individuals_do_not_fall_whatever_they_are_told(number: int) -> None:
    robot = ROBOT.randomised(np.random.default_rng(number))
    plant, space = MjcfPlant(robot, np.random.default_rng(number)), robot.space
    plant.start()
    for _ in range(15):
        command = space.command_centre + space.command_scale * RNG.uniform(-1, 1, 3)
        assert plant.take_step(command).status == StepStatus.OK

"""Steps of a walking robot against finite differences of its ticks, and its nominal map against an integrated lag."""

# pyright: reportAttributeAccessIssue=false

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from itertools import pairwise

import mujoco
import numpy as np
import pytest

from stepgap.mujoco_robots.mjcf.mjcf_robot import MjcfPlant
from stepgap.mujoco_robots.monopod.robot import HoppingGains
from stepgap.mujoco_robots.quadruped.pronk import PronkGains
from stepgap.mujoco_robots.velocity.robot import TrotGains, TrottingRobot
from stepgap.mujoco_robots.velocity.walking_robot import VelocityRange, Walk, WalkingGap, walks
from stepgap.plants.compiled_rig import Rows
from stepgap.plants.ticks.stream import OnTicks
from stepgap.robots.entry_points import load_robot
from stepgap.step import Array, StepStatus

EXACT = replace(TrottingRobot(), gap=WalkingGap.none())
COMMAND = np.array([0.5, 0.1, 0.4])


def plant_of(robot: TrottingRobot, on_ticks: OnTicks | None = None) -> MjcfPlant:
    return MjcfPlant(robot, np.random.default_rng(0), on_ticks)


def test_it_is_found_by_its_name_and_state_and_command_have_different_names() -> None:
    robot = load_robot("velocity")
    assert isinstance(robot, TrottingRobot)
    assert robot.space.state_names == ("vx", "vy", "wz")
    assert robot.space.command_names == ("command_vx", "command_vy", "command_wz")


@pytest.mark.parametrize("seconds", [0.5, 0.35])
def test_the_state_is_the_mean_velocity_in_the_frame_of_the_body(seconds: float) -> None:
    """MuJoCo's integrator moves with the new velocity: that of a tick is the difference of two positions."""
    ticks: list[Rows] = []
    plant = plant_of(replace(EXACT, walk=Walk(seconds=seconds)), lambda rows, _: ticks.append(rows))
    assert plant.start() == pytest.approx(np.zeros(3))
    records = [plant.take_step(COMMAND) for _ in range(3)]
    states = [record.next_state for record in records]
    times = [rows[-1][0] for rows in ticks]
    np.testing.assert_allclose(np.diff(times), seconds, atol=1e-9)
    poses = np.array([row for rows in ticks for row in rows])[:, 1:8]
    rotations = np.array([_matrix(pose[3:]) for pose in poses])
    heading = np.arctan2(rotations[-1, 1, 0], rotations[-1, 0, 0])
    measured = [records[-1].context[name] for name in EXACT.space.pose_names]
    np.testing.assert_allclose(measured, [*poses[-1, :2], heading], atol=1e-9)
    moved = np.einsum("tij,ti->tj", rotations[1:], np.diff(poses[:, :3], axis=0)) / EXACT.tick
    turned = np.array([_turn(a.T @ b)[2] for a, b in pairwise(rotations)]) / EXACT.tick
    number = round(seconds / EXACT.tick)
    for step, state in enumerate(states[1:], 1):
        during = slice(step * number - 1, (step + 1) * number - 1)  # the begins of its ticks
        expected = [*moved[during, :2].mean(axis=0), turned[during].mean()]
        np.testing.assert_allclose(state, expected, atol=1e-6)


def _matrix(quaternion: Array) -> Array:
    matrix = np.empty(9)
    mujoco.mju_quat2Mat(matrix, quaternion)
    return matrix.reshape(3, 3)


def _turn(rotation: Array) -> Array:
    quaternion, turn = np.empty(4), np.empty(3)
    mujoco.mju_mat2Quat(quaternion, rotation.ravel())
    mujoco.mju_quat2Vel(turn, quaternion, 1.0)
    return turn


def test_a_step_that_is_repeated_by_a_copy_changes_nothing() -> None:
    alone, copied = plant_of(EXACT), plant_of(EXACT)
    for plant in (alone, copied):
        plant.start()
        plant.take_step(COMMAND)
    found = copied.repeated(COMMAND, np.random.default_rng(0))
    after = [plant.take_step(COMMAND).next_state for plant in (alone, copied)]
    np.testing.assert_array_equal(after[0], after[1])
    np.testing.assert_array_equal(found, after[0])


def test_a_robot_that_lies_or_is_tilted_has_fallen() -> None:
    model = EXACT.mjcf_model()
    data = mujoco.MjData(model)
    EXACT.place(model, data, np.zeros(3))
    assert not EXACT.failed(model, data)
    for tilt, fell in ((0.85, False), (0.95, True)):
        data.qpos[3:7] = [np.cos(tilt / 2), np.sin(tilt / 2) * 0.6, np.sin(tilt / 2) * 0.8, 0.0]
        assert EXACT.failed(model, data) is fell
    data.qpos[3:7], data.qpos[2] = [1, 0, 0, 0], 0.14
    assert EXACT.failed(model, data)


def test_a_robot_that_is_thrown_over_ends_the_deployment() -> None:
    plant = plant_of(EXACT)
    plant.start()
    plant._stepper._data.qpos[3:7] = [0.5, 0.8, 0.2, 0.1]
    record = plant.take_step(COMMAND)
    assert record.status == StepStatus.FELL
    assert np.isnan(record.next_state).all()


def test_the_lag_is_the_mean_of_a_velocity_that_follows_its_command() -> None:
    robot = replace(EXACT, walk=Walk(seconds=0.4, time_constant=0.15))
    state, velocity, dt = np.array([0.3, -0.1, 0.2]), np.array([0.3, -0.1, 0.2]), 1e-5
    total = np.zeros(3)
    for _ in range(40_000):
        velocity = velocity + dt / 0.15 * (COMMAND - velocity)
        total += velocity * dt
    lag = robot.nominal_maps()["lag"]()
    np.testing.assert_allclose(lag(state, COMMAND), total / 0.4, atol=1e-4)
    at_once = replace(robot, walk=Walk(time_constant=0.0)).nominal_maps()["lag"]()
    np.testing.assert_allclose(at_once(state, COMMAND), COMMAND)


def test_the_reference_stands_walks_slowly_and_stays_in_the_ranges_of_use() -> None:
    space = replace(EXACT, walk=Walk(vx=VelocityRange(0.0, 1.0, -0.2, 1.4))).space
    targets = walks(space).targets
    lower, upper = ([getattr(each, end) for each in space.state] for end in ("lower", "upper"))
    assert ((targets >= lower) & (targets <= upper)).all()
    assert (targets == 0).all(axis=1).any()
    assert 90 <= len(targets) <= 120
    slow = (targets[:, 0] > 0) & (targets[:, 0] <= 0.15)
    assert slow.any()
    assert np.linalg.matrix_rank(targets - targets.mean(axis=0)) == 3


@pytest.mark.parametrize(
    ("kind", "key", "value"),
    [
        (HoppingGains, "stiffness", 0.0),
        (PronkGains, "rest_length", 0.6),
        (PronkGains, "stiffness", -1.0),
        (TrotGains, "period", 0.0),
        (TrotGains, "stance", 1.0),
        (TrotGains, "height", 0.5),
        (Walk, "seconds", 0.0),
        (Walk, "time_constant", -1.0),
        (Walk, "fall_tilt", 4.0),
        (partial(VelocityRange, 0.0, 1.0, command_upper=1.0), "command_lower", 2.0),
    ],
)
def test_settings_out_of_range_are_named(kind: Callable[..., object], key: str, value: float) -> None:
    with pytest.raises(ValueError, match=f"{key} = {value}, but it must"):
        kind(**{key: value})

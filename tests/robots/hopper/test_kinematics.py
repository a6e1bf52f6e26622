"""The kinematic chain is closed, and all joints have the positions of the leg model and of MuJoCo."""

# pyright: reportAttributeAccessIssue=false

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stepgap.plants.rig_plant import RigPlant
from stepgap.plants.ticks.tick_table import TickTable
from stepgap.robots.hopper.kinematics import JOINTS, HopperKinematics, HopperPose, joint_positions
from stepgap.robots.hopper.model.leg import foot, four_bar, leg_of
from stepgap.robots.hopper.parameters import CommandBounds, Gains, RobotParameters
from stepgap.robots.hopper.robot import Hopper
from stepgap.robots.hopper.tick.hop_control import HopperControl
from stepgap.robots.hopper.tick.sensors import HopperSensorModel
from stepgap.robots.hopper.tick.tick_row import TICK_UNITS
from stepgap.robots.hopper.twin.reality_gap import RealityGap
from stepgap.robots.hopper.twin.twin import Twin

ROBOT = RobotParameters()
ANGLES = st.floats(-1.2, 1.2)
POSES = st.builds(HopperPose, ANGLES, st.floats(-0.4, 0.4), ANGLES, st.floats(0.05, 2.5), ANGLES, ANGLES)


class Joints:
    """Joints in a pose by their names."""

    def __init__(self, pivot_height: float, pose: HopperPose):
        self.__dict__.update(zip(JOINTS, joint_positions(ROBOT, pivot_height, pose), strict=True))

    def __getattr__(self, name: str) -> np.ndarray:
        return self.__dict__[name]


def length(start: np.ndarray, end: np.ndarray) -> float:
    return float(np.linalg.norm(end - start))


@settings(deadline=None)
@given(POSES)
def test_the_four_bar_closes(pose: HopperPose) -> None:
    joints = Joints(0.4, pose)
    assert length(joints.hip, joints.front_knee) == pytest.approx(ROBOT.top_length)
    assert length(joints.hip, joints.rear_knee) == pytest.approx(ROBOT.top_length)
    assert length(joints.front_knee, joints.ankle) == pytest.approx(ROBOT.bottom_length)
    assert length(joints.rear_knee, joints.ankle) == pytest.approx(ROBOT.bottom_length)
    assert length(joints.ankle, joints.foot) == pytest.approx(ROBOT.foot_length)
    assert length(joints.rear_knee, joints.foot) == pytest.approx(ROBOT.bottom_length + ROBOT.foot_length)


@settings(deadline=None)
@given(POSES)
def test_the_foot_is_that_of_the_leg(pose: HopperPose) -> None:
    level = replace_pose(pose, yaw=0.0, pitch=0.0)
    joints = Joints(0.4, level)
    toe = foot(leg_of(ROBOT), four_bar(leg_of(ROBOT), pose.alpha_2), pose.alpha_1)
    np.testing.assert_allclose((joints.foot - joints.hip)[[0, 2]], [toe.x, toe.y], atol=1e-12)


@settings(deadline=None)
@given(POSES)
def test_the_boom_is_rigid_and_the_leg_swings_in_the_plane_of_its_tip(pose: HopperPose) -> None:
    joints = Joints(0.4, replace_pose(pose, deflection_forward=0.0, deflection_up=0.0))
    boom = joints.hip - joints.pivot
    assert np.linalg.norm(boom) == pytest.approx(ROBOT.boom_length)
    for joint in (joints.front_knee, joints.rear_knee, joints.ankle, joints.foot):
        assert (joint - joints.hip) @ boom == pytest.approx(0, abs=1e-12)


def replace_pose(pose: HopperPose, **changes: float) -> HopperPose:
    return pose._replace(**changes)


@pytest.mark.parametrize("stiffness", [np.inf, 3000.0])
def test_every_joint_has_its_position_in_mujoco(stiffness: float) -> None:
    gap = replace(RealityGap(), boom_stiffness=stiffness)
    twin = Twin(ROBOT, gap, np.random.default_rng(3))
    data, compared = twin._scratch, 0

    def compare(_rows: object, _step: int) -> None:
        nonlocal compared
        true, sensors = twin.true_state(), twin.sensor_model
        front, rear = true.leg
        (yaw, pitch), (along, up) = true.boom, true.deflection
        pose = HopperPose(yaw, pitch, (front + rear) / 2, (front - rear) / 2, along, up)
        joints = Joints(sensors.pivot_height, pose)
        opening = float(np.linalg.norm(data.site("front_joint").xpos - data.site("rear_joint").xpos))
        near = {"rtol": 0, "atol": max(1e-6, 5 * opening)}
        np.testing.assert_allclose(joints.hip, data.body("front_top").xpos, rtol=0, atol=1e-9)
        np.testing.assert_allclose(joints.front_knee, data.body("front_bottom").xpos, rtol=0, atol=1e-9)
        np.testing.assert_allclose(joints.rear_knee, data.body("rear_bottom").xpos, rtol=0, atol=1e-9)
        np.testing.assert_allclose(joints.ankle, data.site("rear_joint").xpos, **near)
        np.testing.assert_allclose(joints.foot, true.foot, **near)
        compared += 1

    with RigPlant(twin, HopperControl(ROBOT, Gains(), CommandBounds()), compare, at_once=1) as plant:
        plant.start()
        plant.take_step(np.array([2.0, -5.0]))
    assert compared > 500


def test_a_measured_motion_is_read_from_counts() -> None:
    sensors = HopperSensorModel(
        tick=1e-3,
        boom_length=1.5,
        pivot_height=0.4,
        motor_counts=1000,
        boom_counts_horizontal=4000,
        boom_counts_vertical=8000,
        touchdown_force=20,
        takeoff_length=0.28,
    )
    kinematics = HopperKinematics(replace(ROBOT, boom_length=1.5), Gains(), sensors)
    units = {**dict.fromkeys(TICK_UNITS, ""), "step": ""}
    rows = {"boom_horizontal": [0, 1000], "boom_vertical": [0, 8000 / 12], "alpha_1": [0.1, 0.2], "alpha_2": [0.9, 1.0]}
    rows |= {"contact_force": [0, 50], "step": [3, 4], "time": [0, 0.01], "applied_1": [7, -7], "applied_2": [2, 5]}
    table = TickTable(units, np.array([rows.get(name, [0, 0]) for name in units], float).T)
    shown, scene = kinematics.motion(table), kinematics.scene
    hip = shown.positions[:, scene.index("hip")]
    np.testing.assert_allclose(hip[0], [0, -1.5, 0.4], atol=1e-12)
    np.testing.assert_allclose(hip[1], [1.5 * np.cos(np.pi / 6), 0, 0.4 + 1.5 / 2], atol=1e-12)
    assert scene.progress(shown.positions).tolist() == pytest.approx([0, np.pi / 2])
    assert shown.step.tolist() == [3, 4]
    assert shown.touching.tolist() == [[0], [1]]
    lengths = [four_bar(leg_of(ROBOT), alpha_2).length for alpha_2 in rows["alpha_2"]]
    signals = dict(zip(scene.signals, shown.signals.T.tolist(), strict=True))
    assert signals.pop("leg length") == pytest.approx(lengths)
    assert signals == {"leg angle": [0.1, 0.2], "torque of motor 1": [7, -7], "torque of motor 2": [2, 5]}
    with pytest.raises(ValueError, match="finite"):
        kinematics.motion(TickTable(units, np.full((1, len(units)), np.nan)))


@pytest.mark.parametrize("height", [0.5, 0.6])
def test_at_the_apex_the_hip_has_its_height_and_the_leg_its_landing_length(height: float) -> None:
    kinematics = Hopper().kinematics()
    hip, ankle = (kinematics.at_section(np.array([0.2, height]))[kinematics.scene.index(n)] for n in ("hip", "ankle"))
    assert hip[2] == pytest.approx(height)
    assert length(hip, ankle) == pytest.approx(Gains().landing_length)

"""The kinematic chain is closed, and all joints have the positions of the leg model and of MuJoCo."""

# pyright: reportAttributeAccessIssue=false

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stepgap.plants.rig_plant import RigPlant
from stepgap.robots.hopper.hop_control import HopperControl
from stepgap.robots.hopper.leg import foot, four_bar, leg_of
from stepgap.robots.hopper.parameters import CommandBounds, Gains, RobotParameters
from stepgap.robots.hopper.twin.reality_gap import RealityGap
from stepgap.robots.hopper.twin.twin import Twin
from stepgap.view.geometry import HopperPose, joints_at, turned_to

ROBOT = RobotParameters()
ANGLES = st.floats(-1.2, 1.2)
POSES = st.builds(HopperPose, ANGLES, st.floats(-0.4, 0.4), ANGLES, st.floats(0.05, 2.5), ANGLES, ANGLES)


def length(start: np.ndarray, end: np.ndarray) -> float:
    return float(np.linalg.norm(end - start))


@settings(deadline=None)
@given(POSES)
def test_the_four_bar_closes(pose: HopperPose) -> None:
    joints = joints_at(ROBOT, 0.4, pose)
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
    joints = joints_at(ROBOT, 0.4, level)
    toe = foot(leg_of(ROBOT), four_bar(leg_of(ROBOT), pose.alpha_2), pose.alpha_1)
    np.testing.assert_allclose((joints.foot - joints.hip)[[0, 2]], [toe.x, toe.y], atol=1e-12)


@settings(deadline=None)
@given(POSES)
def test_the_boom_is_rigid_and_the_leg_swings_in_the_plane_of_its_tip(pose: HopperPose) -> None:
    joints = joints_at(ROBOT, 0.4, replace_pose(pose, deflection_forward=0.0, deflection_up=0.0))
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

    def compare(_: object) -> None:
        nonlocal compared
        true, sensors = twin.true_state(), twin.sensor_model
        front, rear = true.leg
        (yaw, pitch), (along, up) = true.boom, true.deflection
        pose = HopperPose(yaw, pitch, (front + rear) / 2, (front - rear) / 2, along, up)
        joints = joints_at(ROBOT, sensors.pivot_height, pose)
        near = {"rtol": 0, "atol": max(1e-6, 5 * true.closure_error)}
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


@settings(deadline=None)
@given(st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda v: np.linalg.norm(v) > 1e-3))
def test_a_turn_takes_z_to_the_direction(direction: tuple[float, float, float]) -> None:
    w, *xyz = turned_to(np.array(direction))
    axis, z = np.array(xyz), np.array([0.0, 0.0, 1.0])
    turned = z + 2 * np.cross(axis, np.cross(axis, z) + w * z)
    np.testing.assert_allclose(turned, np.array(direction) / np.linalg.norm(direction), atol=1e-6)

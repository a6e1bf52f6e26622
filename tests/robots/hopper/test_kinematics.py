"""All joints have the positions of MuJoCo."""

# pyright: reportAttributeAccessIssue=false

from dataclasses import replace

import numpy as np
import pytest

from stepgap.plants.rig_plant import RigPlant
from stepgap.plants.ticks.tick_table import TickTable
from stepgap.robots.hopper.kinematics import JOINTS, HopperKinematics, HopperPose, joint_positions
from stepgap.robots.hopper.model.leg import four_bar, leg_of
from stepgap.robots.hopper.parameters import CommandBounds, Gains, RobotParameters
from stepgap.robots.hopper.robot import Hopper
from stepgap.robots.hopper.tick.hop_control import HopperControl
from stepgap.robots.hopper.tick.sensors import HopperSensorModel
from stepgap.robots.hopper.tick.tick_row import TICK_UNITS
from stepgap.robots.hopper.twin.reality_gap import RealityGap
from stepgap.robots.hopper.twin.twin import Twin

ROBOT = RobotParameters()


class Joints:
    """Joints in a pose by their names."""

    def __init__(self, pivot_height: float, pose: HopperPose):
        self.__dict__.update(zip(JOINTS, joint_positions(ROBOT, pivot_height, pose), strict=True))

    def __getattr__(self, name: str) -> np.ndarray:
        return self.__dict__[name]


def test_every_joint_has_its_position_in_mujoco() -> None:
    twin = Twin(ROBOT, replace(RealityGap(), boom_stiffness=3000.0), np.random.default_rng(3))
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
    assert np.linalg.norm(ankle - hip) == pytest.approx(Gains().landing_length)

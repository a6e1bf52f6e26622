"""Limits of the stages of a deployment, and a robot with inverted wiring, which they stop."""

from dataclasses import replace
from math import inf, pi
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stepgap.base.compiled_record import as_record
from stepgap.hardware.hopper.ethercat import read_rig_settings
from stepgap.hardware.realtime.board import Board, Request
from stepgap.hardware.realtime.loop import ControlLoop, LoopSettings
from stepgap.plants.tick_control import Mode
from stepgap.robots.hopper import CommandBounds, Gains, RobotParameters
from stepgap.robots.hopper.tick.hop_control import HopControl
from stepgap.robots.hopper.tick.limits import SafetyLimits
from stepgap.robots.hopper.tick.sensors import hopper_sensors
from stepgap.robots.hopper.tick.stage import Stage, stage_of
from stepgap.robots.hopper.twin.reality_gap import RealityGap
from tests.hardware.hopper.test_jog import COUNTS, HangingTwin, Wiring
from tests.hardware.realtime.test_loop import COLUMN

EXAMPLE = Path(__file__).parents[4] / "examples" / "rig.toml"
LIMITS = SafetyLimits(
    torque=38.0, joint_speed=80.0, posture_torque=3.0, posture_speed=10.0, first_share=0.5, first_hops=4
)
RECORD = as_record(LIMITS)[0]
MODES = st.sampled_from([int(mode) for mode in Mode])


@pytest.mark.parametrize(
    ("mode", "share", "hops", "expected"),
    [
        (Mode.POSTURE, 0.5, 0, (3.0, 10.0)),
        (Mode.POSTURE, 0.5, 9, (3.0, 10.0)),
        (Mode.STEP, 1.0, 0, (19.0, 40.0)),
        (Mode.STEP, 1.0, 1, (23.75, 50.0)),
        (Mode.STEP, 1.0, 3, (33.25, 70.0)),
        (Mode.STEP, 1.0, 4, (38.0, 80.0)),
        (Mode.STEP, 1.0, 500, (38.0, 80.0)),
        (Mode.LAND, 0.0, 4, (38.0, 80.0)),
        (Mode.LAND, 0.5, 4, (19.0, 80.0)),
        (Mode.LAND, 0.5, 0, (9.5, 40.0)),
        (Mode.LAND, 1.0, 4, (3.0, 80.0)),
        (Mode.LAND, 1.2, 4, (3.0, 80.0)),
        (Mode.LIMP, 0.0, 0, (19.0, 40.0)),
    ],
)
def test_the_limits_of_each_stage(mode: Mode, share: float, hops: int, expected: tuple[float, float]):
    assert stage_of(RECORD, int(mode), share, hops) == Stage(*expected)


@given(MODES, st.floats(0, 2), st.integers(0, 10**6))
def test_no_stage_exceeds_the_limits_and_none_is_zero(mode: int, share: float, hops: int):
    torque, joint_speed = stage_of(RECORD, mode, share, hops)
    assert 0 < torque <= LIMITS.torque
    assert 0 < joint_speed <= LIMITS.joint_speed


@given(MODES, st.floats(0, 1), st.integers(0, 1000))
def test_a_simulated_robot_has_its_full_limits_in_every_stage(mode: int, share: float, hops: int):
    limits = SafetyLimits(torque=38.0, joint_speed=inf)
    assert stage_of(as_record(limits)[0], mode, share, hops) == Stage(38.0, inf)


@pytest.mark.parametrize("motor", [1, 2])
def test_an_inverted_motor_is_stopped_while_the_robot_takes_its_posture(motor: int):
    """Such a motor drives its link away from the posture; with the full limits it reached 83 rad/s and 69°."""
    limits = replace(read_rig_settings(EXAMPLE).limits, late_ticks=40, sample_jitter=0.1)
    sensors = hopper_sensors(HangingTwin(Wiring(), RealityGap(), 0).sensor_model)
    control = HopControl(sensors, RobotParameters(), Gains(), limits)
    board, rows = Board.create(2, 2, 1), []
    wiring = Wiring(lambda torque_1, torque_2: (-torque_1, torque_2) if motor == 1 else (torque_1, -torque_2))
    with HangingTwin(wiring, RealityGap(joint_damping=0.05), seed=motor) as rig:
        loop = ControlLoop(rig, control, CommandBounds().space(), board, rows.append, LoopSettings(release_time=inf))
        board.request = Request.START
        while loop.tick():
            pass
        angles = np.array(rig.counts)[:, motor - 1] / COUNTS * 360
        speed = np.abs(np.diff(angles)).max() * 1000 * pi / 180
    message = board.message
    board.close()
    board.unlink()
    assert message.startswith("the safety function stopped the robot: joint speed (1")
    assert "at most 10.0 in this stage" in message
    torques = np.array(rows)[:, [COLUMN["applied_1"], COLUMN["applied_2"]]]
    assert np.nanmax(np.abs(torques)) <= 3.0
    assert speed < 12.0
    assert np.ptp(angles) < 40.0

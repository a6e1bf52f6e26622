"""Limits of the stages of a deployment, and a robot with inverted wiring, which they stop."""

from math import inf

import pytest
from hypothesis import given
from hypothesis import strategies as st

from stepgap.base.compiled_record import as_record
from stepgap.plants.tick_control import Mode
from stepgap.robots.hopper.limits import SafetyLimits
from stepgap.robots.hopper.stage import Stage, stage_of

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

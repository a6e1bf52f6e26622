import math

from hypothesis import given
from hypothesis import strategies as st

from stepgap.hopper import RobotParameters
from stepgap.plants.safety import Limited, SafetyLimits, check_torque

LIMITS = SafetyLimits.of(RobotParameters())
ANY = st.floats(allow_nan=True, allow_infinity=True, width=64)


@given(ANY, ANY, ANY, ANY, ANY)
def test_whatever_comes_in_the_torque_is_finite_and_within_limits(torque_1, torque_2, alpha_2, rate_1, rate_2):
    checked = check_torque(LIMITS, torque_1, torque_2, alpha_2, rate_1, rate_2)
    assert abs(checked.torque_1) <= LIMITS.torque
    assert abs(checked.torque_2) <= LIMITS.torque
    if not all(map(math.isfinite, (torque_1, torque_2, alpha_2, rate_1, rate_2))):
        assert checked == (0.0, 0.0, Limited.NOT_FINITE)


@given(st.floats(-40, 40), st.floats(-40, 40), st.floats(0.1, 2), st.floats(-50, 50), st.floats(-50, 50))
def test_an_allowed_torque_is_written_as_asked(torque_1, torque_2, alpha_2, rate_1, rate_2):
    checked = check_torque(LIMITS, torque_1, torque_2, alpha_2, rate_1, rate_2)
    assert checked == (torque_1, torque_2, Limited.NOTHING)


def test_a_fast_joint_and_a_stretched_leg_are_told():
    assert check_torque(LIMITS, 1, 1, 0.5, 100, 100) == (0, 0, Limited.JOINT_SPEED)
    assert Limited.JOINT_SPEED.stops
    stretching = check_torque(LIMITS, -2, 4, 0.05, 0, 0)  # τ₁ < τ₂ closes the top links, which stretches the leg
    assert stretching == (1, 1, Limited.STRETCH)
    assert not Limited.STRETCH.stops
    assert check_torque(LIMITS, 4, -2, 0.05, 0, 0) == (4, -2, Limited.NOTHING)
    assert check_torque(LIMITS, 50, -60, 0.5, 0, 0) == (40, -40, Limited.TORQUE)

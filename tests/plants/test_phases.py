import math

from stepgap.plants.phases import Phase, next_phase


def follow(phase, **sensed):
    quiet = {
        "apex_passed": False,
        "contact_force": 0.0,
        "touchdown_force": 5.0,
        "leg_length": 0.26,
        "takeoff_length": 0.287,
        "hip_rate": -1.0,
    }
    return next_phase(phase, **(quiet | sensed))


def test_a_hop_goes_through_its_phases_in_order():
    assert follow(Phase.RISING) == Phase.RISING
    assert follow(Phase.RISING, apex_passed=True) == Phase.FALLING
    assert follow(Phase.FALLING, contact_force=5.0) == Phase.FALLING
    assert follow(Phase.FALLING, contact_force=5.1) == Phase.LOADING
    assert follow(Phase.LOADING, contact_force=100.0, hip_rate=-0.01) == Phase.LOADING
    assert follow(Phase.LOADING, contact_force=100.0, hip_rate=0.01) == Phase.PUSHING
    assert follow(Phase.PUSHING, contact_force=50.0, leg_length=0.286, hip_rate=1.0) == Phase.PUSHING


def test_take_off_is_by_leg_extension_or_by_losing_the_ground():
    assert follow(Phase.PUSHING, contact_force=50.0, leg_length=0.287) == Phase.RISING
    assert follow(Phase.PUSHING, contact_force=0.0, takeoff_length=math.inf) == Phase.RISING


def test_contact_while_rising_is_no_touchdown():
    assert follow(Phase.RISING, contact_force=80.0) == Phase.RISING


def test_an_impact_that_bounces_is_no_take_off():
    assert follow(Phase.LOADING, contact_force=0.0, leg_length=0.3) == Phase.LOADING


def test_a_body_that_comes_down_with_its_foot_on_the_ground_has_not_flown():
    assert follow(Phase.RISING, apex_passed=True, contact_force=80.0) == Phase.PUSHING
    assert follow(Phase.RISING, apex_passed=True, contact_force=5.0) == Phase.FALLING

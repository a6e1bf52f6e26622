import math

from stepgap.robots.hopper.tick.phases import Phase, next_phase


def phase_after(phase, **sensed):
    quiet = {
        "apex_passed": False,
        "contact_force": 0.0,
        "touchdown_force": 5.0,
        "leg_length": 0.26,
        "takeoff_length": 0.287,
        "hip_rate": -1.0,
    }
    return next_phase(int(phase), **(quiet | sensed))


def test_a_hop_goes_through_its_phases_in_order():
    assert phase_after(Phase.ASCENT) == Phase.ASCENT
    assert phase_after(Phase.ASCENT, apex_passed=True) == Phase.DESCENT
    assert phase_after(Phase.DESCENT, contact_force=5.0) == Phase.DESCENT
    assert phase_after(Phase.DESCENT, contact_force=5.1) == Phase.COMPRESSION
    assert phase_after(Phase.COMPRESSION, contact_force=100.0, hip_rate=-0.01) == Phase.COMPRESSION
    assert phase_after(Phase.COMPRESSION, contact_force=100.0, hip_rate=0.01) == Phase.THRUST
    assert phase_after(Phase.THRUST, contact_force=50.0, leg_length=0.286, hip_rate=1.0) == Phase.THRUST


def test_take_off_is_by_leg_extension_or_by_losing_the_ground():
    assert phase_after(Phase.THRUST, contact_force=50.0, leg_length=0.287) == Phase.ASCENT
    assert phase_after(Phase.THRUST, contact_force=0.0, takeoff_length=math.inf) == Phase.ASCENT


def test_contact_while_rising_is_no_touchdown():
    assert phase_after(Phase.ASCENT, contact_force=80.0) == Phase.ASCENT


def test_an_impact_that_bounces_is_no_take_off():
    assert phase_after(Phase.COMPRESSION, contact_force=0.0, leg_length=0.3) == Phase.COMPRESSION


def test_a_hip_that_descends_with_the_foot_on_the_ground_has_not_taken_off():
    assert phase_after(Phase.ASCENT, apex_passed=True, contact_force=80.0) == Phase.THRUST
    assert phase_after(Phase.ASCENT, apex_passed=True, contact_force=5.0) == Phase.DESCENT

"""Phases of a hop, detected from sensor values (Secs. 3.3, 3.4)."""

from enum import IntEnum

from stepgap.base.compiled import as_written


class Phase(IntEnum):
    """Phase of a hop; the command acts during THRUST, that is after mid-stance."""

    ASCENT = 0
    DESCENT = 1
    COMPRESSION = 2
    THRUST = 3


@as_written
def next_phase(phase, apex_passed, contact_force, touchdown_force, leg_length, takeoff_length, hip_rate):
    """Number of the phase at this tick, from the phase at the previous one.

    If the hip descends while the foot is still on the ground, the robot has not taken off, and the phase is THRUST.

    Args:
        phase: Number of the previous phase.
        apex_passed: Whether the apex of the present flight has been passed.
        contact_force: Ground force on the foot [N].
        touchdown_force: Force above which the foot is on the ground [N] (Sec. 3.3).
        leg_length: ℓ [m].
        takeoff_length: ℓ at which the leg leaves the ground [m] (Sec. 3.4).
        hip_rate: ẏ [m/s].
    """
    grounded = contact_force > touchdown_force
    if phase == Phase.ASCENT and apex_passed:
        return Phase.THRUST.value if grounded else Phase.DESCENT.value
    if phase == Phase.DESCENT and grounded:
        return Phase.COMPRESSION.value
    if phase == Phase.COMPRESSION and hip_rate > 0:
        return Phase.THRUST.value
    if phase == Phase.THRUST and (leg_length >= takeoff_length or contact_force <= 0):
        return Phase.ASCENT.value
    return phase

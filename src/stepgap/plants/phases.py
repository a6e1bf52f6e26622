"""Flight or stance, told from what hardware senses (Secs. 3.3, 3.4)."""

from enum import IntEnum


class Phase(IntEnum):
    """Where in the hop the leg is; the command acts while PUSHING, that is after mid-stance."""

    RISING = 0
    FALLING = 1
    LOADING = 2
    PUSHING = 3


def next_phase(
    phase: Phase,
    *,
    apex_passed: bool,
    contact_force: float,
    touchdown_force: float,
    leg_length: float,
    takeoff_length: float,
    hip_rate: float,
) -> Phase:
    """The phase that follows at this tick.

    A body that comes down with the foot still on the ground has not flown: the leg pushes on.

    Args:
        phase: Present phase.
        apex_passed: The apex of the present flight is behind.
        contact_force: Ground force on the foot [N].
        touchdown_force: Force above which the foot is on the ground [N] (Sec. 3.3).
        leg_length: ℓ [m].
        takeoff_length: ℓ at which the leg leaves the ground [m] (Sec. 3.4).
        hip_rate: ẏ [m/s].
    """
    if phase == Phase.RISING and apex_passed:
        return Phase.PUSHING if contact_force > touchdown_force else Phase.FALLING
    if phase == Phase.RISING:
        return phase
    if phase == Phase.FALLING:
        return Phase.LOADING if contact_force > touchdown_force else phase
    if phase == Phase.LOADING:
        return Phase.PUSHING if hip_rate > 0 else phase
    airborne = leg_length >= takeoff_length or contact_force <= 0
    return Phase.RISING if airborne else phase

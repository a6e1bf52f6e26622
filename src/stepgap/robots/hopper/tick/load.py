"""Load of the motors over time: heat beyond the continuous torque (i²t), and mean mechanical power.

The copper losses of a motor are proportional to the square of its torque. With τc the torque that it withstands for any
time, the integral of τ² − τc², not below zero, is what it has stored; `overload_time` is how long it withstands the
full torque from cold. The mean power of both motors is low-pass filtered: a robot that a wrong sign feeds with energy,
or that works against a stop, takes more than one that hops.
"""

from math import inf
from typing import NamedTuple

from stepgap.base.compiled import as_written
from stepgap.robots.hopper.tick.safety import Limited

POWER_TIME = 2.0  # Time constant of the mean power [s]; a hop takes less than one

_OVERLOAD = int(Limited.OVERLOAD)
_POWER = int(Limited.POWER)


class Load(NamedTuple):
    """Load so far.

    Attributes:
        heat_1: Integral of τ² − τc² of motor 1 [N²·m²·s].
        heat_2: That of motor 2 [N²·m²·s].
        power: Mean mechanical power of both motors [W].
    """

    heat_1: float = 0.0
    heat_2: float = 0.0
    power: float = 0.0


@as_written
def add_load(limits, tick, load, motion, torque_1, torque_2):
    """Returns the `Load` after another tick, and the reasons to stop, as the number of a `Limited`.

    Args:
        limits: `SafetyLimits`.
        tick: Time of a tick [s].
        load: `Load` after the tick before.
        motion: `JointMotion` of this tick.
        torque_1: Torque of motor 1 in this tick [N·m].
        torque_2: Torque of motor 2 in this tick [N·m].
    """
    heat_1 = _heated(limits, tick, load.heat_1, torque_1)
    heat_2 = _heated(limits, tick, load.heat_2, torque_2)
    given = abs(torque_1 * (motion.rate_1 + motion.rate_2)) + abs(torque_2 * (motion.rate_1 - motion.rate_2))
    power = load.power + (given - load.power) * tick / POWER_TIME
    reason = 0
    most = (limits.torque * limits.torque - _continuous(limits)) * limits.overload_time
    if max(heat_1, heat_2) > most:
        reason |= _OVERLOAD
    if power > limits.mean_power:
        reason |= _POWER
    return Load(heat_1, heat_2, power), reason


@as_written
def _heated(limits, tick, heat, torque):
    return max(0.0, heat + (torque * torque - _continuous(limits)) * tick)


@as_written
def _continuous(limits):
    """Square of the continuous torque, at most that of the largest one [N²·m²]."""
    if limits.continuous_torque == inf:
        return limits.torque * limits.torque
    return min(limits.torque, limits.continuous_torque) ** 2

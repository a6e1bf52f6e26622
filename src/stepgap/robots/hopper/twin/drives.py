"""The twin's drives, compiled: command, delay and lag, as the mean torque over a physics step of any length.

MuJoCo has delays and lags, too, but it delays by whole steps, and holds over a step the torque of its beginning.
"""

import numpy as np

from stepgap.base.compiled import as_written

_LATEST = 0
_TORQUE = 1
_QUEUE = 3
"""Where the drives' memory has the number of the latest command, both torques after the lag, and the queue of commands.

The memory is MuJoCo's `userdata`, so that it is copied and reset with the motion.
"""


def memory_size(delay: float) -> int:
    """Count of numbers that the drives remember for a delay [ticks]."""
    return _QUEUE + 2 * _queue_length(delay)


@as_written
def _queue_length(delay):
    """Count of commands that are in the queue: with that which comes, and that which ends in its tick."""
    return int(np.floor(delay)) + 2


@as_written
def command(rig, memory, torque_1, torque_2):
    """Puts the torques of a tick into the queue [N·m].

    Args:
        rig: Record of `Devices`.
        memory: MuJoCo's `userdata`.
        torque_1: Torque of motor 1.
        torque_2: Torque of motor 2.
    """
    latest = (int(memory[_LATEST]) + 1) % _queue_length(rig.delay)
    memory[_LATEST] = latest
    memory[_QUEUE + 2 * latest] = torque_1
    memory[_QUEUE + 2 * latest + 1] = torque_2


@as_written
def deliver(rig, memory, ctrl, begin, end):
    """Gives MuJoCo the mean torques over a part of a tick, and takes the lag to its end.

    A command u reaches the motor after the delay, and the torque a follows it as a' = (u − a)/T with the lag's time
    constant T: over a time t its mean is u + (a − u) (1 − exp(−t/T)) T/t.

    Args:
        rig: Record of `Devices`.
        memory: MuJoCo's `userdata`.
        ctrl: The torques; shape (2,) [N·m].
        begin: When the part begins [ticks].
        end: When it ends [ticks].
    """
    length = _queue_length(rig.delay)
    change = min(max(rig.delay - np.floor(rig.delay), begin), end)  # when the later of two commands begins
    place = int(memory[_LATEST]) + 1  # of the oldest command, which ends in this tick
    ctrl[0] = 0.0
    ctrl[1] = 0.0
    for time in (change - begin, end - change):
        if time > 0.0:
            kept = np.exp(-time / rig.lag) if rig.lag > 0.0 else 0.0
            for motor in range(2):
                aim = memory[_QUEUE + 2 * (place % length) + motor]
                off = memory[_TORQUE + motor] - aim
                ctrl[motor] += (time * aim + rig.lag * (1.0 - kept) * off) / (end - begin)
                memory[_TORQUE + motor] = aim + kept * off
        place += 1

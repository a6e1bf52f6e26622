"""What a rig that can break things may do next."""

from enum import IntEnum
from typing import NamedTuple


class RigState(IntEnum):
    """Stages of a deployment on hardware; torque is given only in STAND, HOP and STOP, and while a FAULT brakes."""

    OFF = 0
    CONNECT = 1
    CALIBRATE = 2
    READY = 3
    STAND = 4
    HOP = 5
    STOP = 6
    FAULT = 7


MOVING = frozenset({RigState.STAND, RigState.HOP, RigState.STOP})
"""States in which the control laws' torques are written."""


class Signals(NamedTuple):
    """What decides.

    Attributes:
        connected: The bus is up and the drives take torque commands.
        calibrated: The limp robot's sensors have been plausible for long enough.
        hop_asked: A person wants it to hop.
        stop_asked: A person, or a process that is missed, wants it to stop.
        stood: The landing posture is held with full torque.
        at_rest: It has had the time to land.
        fault: Something is wrong.
    """

    connected: bool = False
    calibrated: bool = False
    hop_asked: bool = False
    stop_asked: bool = False
    stood: bool = False
    at_rest: bool = False
    fault: bool = False


def next_state(state: RigState, signals: Signals) -> RigState:
    """The state that follows at this tick: one stage at a time, to FAULT from anywhere, and from FAULT nowhere."""
    if signals.fault or state == RigState.FAULT:
        return RigState.FAULT
    if state == RigState.OFF:
        return RigState.OFF if signals.stop_asked else RigState.CONNECT
    if state == RigState.STOP:
        return RigState.OFF if signals.at_rest else RigState.STOP
    if signals.stop_asked:
        return RigState.STOP if state in MOVING else RigState.OFF
    onward = {
        RigState.CONNECT: signals.connected,
        RigState.CALIBRATE: signals.calibrated,
        RigState.READY: signals.hop_asked,
        RigState.STAND: signals.stood,
        RigState.HOP: False,
    }
    return RigState(state + 1) if onward[state] else state

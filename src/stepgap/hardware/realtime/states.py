"""The state machine of a deployment on hardware."""

from typing import NamedTuple

from stepgap.plants.ticks.rig_state import RigState

MOVING = frozenset({RigState.STAND, RigState.STEP, RigState.STOP})
"""States in which the control laws' torques are written."""


class Signals(NamedTuple):
    """Signals that determine the next state.

    Attributes:
        connected: The bus is up and the drives accept torque commands.
        calibrated: The limp robot's sensors have been plausible for long enough.
        start_requested: A person has requested that the robot takes steps.
        stop_requested: A person has requested the stop, or the learning process does not respond.
        stood: The posture for the release is held with full torque.
        at_rest: The robot has had the time to land.
        fault: There is a fault.
    """

    connected: bool = False
    calibrated: bool = False
    start_requested: bool = False
    stop_requested: bool = False
    stood: bool = False
    at_rest: bool = False
    fault: bool = False


def next_state(state: RigState, signals: Signals) -> RigState:
    """The next state: one transition per tick; FAULT can follow on any state and is never left."""
    if signals.fault or state == RigState.FAULT:
        return RigState.FAULT
    if state == RigState.OFF:
        return RigState.OFF if signals.stop_requested else RigState.CONNECT
    if state == RigState.STOP:
        return RigState.OFF if signals.at_rest else RigState.STOP
    if signals.stop_requested:
        return RigState.STOP if state in MOVING else RigState.OFF
    may_continue = {
        RigState.CONNECT: signals.connected,
        RigState.CALIBRATE: signals.calibrated,
        RigState.READY: signals.start_requested,
        RigState.STAND: signals.stood,
        RigState.STEP: False,
    }
    return RigState(state + 1) if may_continue[state] else state

from itertools import product

from stepgap.hardware.realtime.loop import MOVING, Signals, next_state
from stepgap.plants.ticks.rig_state import RigState

EVERY = [
    (state, Signals(*values)) for state in RigState for values in product([False, True], repeat=len(Signals._fields))
]


def test_a_fault_is_reached_from_any_state_and_never_left():
    for state, signals in EVERY:
        if state == RigState.FAULT or signals.fault:
            assert next_state(state, signals) == RigState.FAULT
        else:
            assert next_state(state, signals) != RigState.FAULT


def test_no_state_is_skipped():
    onward = {(state, RigState(state + 1)) for state in RigState if state < RigState.STEP}
    down = {(state, RigState.STOP) for state in (RigState.STAND, RigState.STEP)} | {(RigState.STOP, RigState.OFF)}
    down |= {(state, RigState.OFF) for state in (RigState.CONNECT, RigState.CALIBRATE, RigState.READY)}
    steps = {(state, next_state(state, signals)) for state, signals in EVERY}
    steps = {(a, b) for a, b in steps if a != b and b != RigState.FAULT}
    assert steps == onward | down


def test_torque_is_on_only_from_a_request_to_hop_until_a_request_to_stop():
    for state, signals in EVERY:
        after = next_state(state, signals)
        if after in MOVING and state not in MOVING:
            assert signals.start_requested
            assert not signals.stop_requested
        if signals.stop_requested:
            assert after in (RigState.STOP, RigState.OFF, RigState.FAULT)

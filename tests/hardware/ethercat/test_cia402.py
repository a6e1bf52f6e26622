"""The power drive system state machine, compared with canopen's tables of the same standard."""

import itertools

import pytest
from canopen.profiles.p402 import State402

from stepgap.hardware.ethercat.cia402 import State, Wanted, next_controlword, state_of

NAMES = {
    State.NOT_READY: "NOT READY TO SWITCH ON",
    State.SWITCH_ON_DISABLED: "SWITCH ON DISABLED",
    State.READY: "READY TO SWITCH ON",
    State.SWITCHED_ON: "SWITCHED ON",
    State.ENABLED: "OPERATION ENABLED",
    State.QUICK_STOP: "QUICK STOP ACTIVE",
    State.FAULT_REACTION: "FAULT REACTION ACTIVE",
    State.FAULT: "FAULT",
}
AUTOMATIC = {"NOT READY TO SWITCH ON": "SWITCH ON DISABLED", "FAULT REACTION ACTIVE": "FAULT"}


def drive_after(state: str, controlword: int) -> str:
    """Next state for a controlword in canopen's table."""
    if state in AUTOMATIC:
        return AUTOMATIC[state]
    moves = {source: target for (source, target), word in State402.TRANSITIONTABLE.items() if word == controlword}
    return moves.get(state, state)


def test_every_statusword_is_read_as_canopen_reads_it() -> None:
    for word in range(2**16):
        matching = {name for name, (mask, bits) in State402.SW_MASK.items() if word & mask == bits}
        assert matching == ({NAMES[state_of(word)]} if state_of(word) != State.UNKNOWN else set())


@pytest.mark.parametrize(
    ("wanted", "start", "path"),
    [
        (Wanted.ENABLED, "NOT READY TO SWITCH ON", ["SWITCH ON DISABLED", "READY TO SWITCH ON", "SWITCHED ON"]),
        (Wanted.ENABLED, "QUICK STOP ACTIVE", ["SWITCH ON DISABLED", "READY TO SWITCH ON", "SWITCHED ON"]),
        (Wanted.RESET, "FAULT", ["SWITCH ON DISABLED"]),
        (Wanted.RESET, "FAULT REACTION ACTIVE", ["FAULT", "SWITCH ON DISABLED"]),
    ],
)
def test_a_drive_reaches_the_wanted_state(wanted: Wanted, start: str, path: list[str]) -> None:
    state, seen = start, []
    for _ in range(8):
        _, controlword = next_controlword(State402.SW_MASK[state][1], wanted)
        after = drive_after(state, controlword)
        seen += [after] if after != state else []
        state = after
    assert seen == path + (["OPERATION ENABLED"] if wanted == Wanted.ENABLED else [])


def test_a_fault_is_never_reset_without_request() -> None:
    for state in (State.FAULT, State.FAULT_REACTION):
        word = State402.SW_MASK[NAMES[state]][1]
        assert next_controlword(word, Wanted.ENABLED) == (state, 0)


def test_enable_is_commanded_only_to_a_drive_that_is_ready_for_it() -> None:
    for word, wanted in itertools.product(range(2**8), Wanted):
        state, controlword = next_controlword(word, wanted)
        if controlword == 0x0F:
            assert wanted == Wanted.ENABLED
            assert state in (State.SWITCHED_ON, State.ENABLED)

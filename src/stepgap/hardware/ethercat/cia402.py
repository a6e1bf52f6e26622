"""The power drive system state machine (CiA 402, IEC 61800-7-201), as a pure function."""

from enum import Enum, auto

STATUSWORD_UNIT = "CiA 402"  # Unit of a logged field whose number is a status word

WARNING = 0x0080  # Bit of a status word: the drive warns
INTERNAL_LIMIT = 0x0800  # Bit of a status word: a limit inside the drive acts
FOLLOWS_COMMAND = 0x1000  # Bit of a status word: the drive follows the command value

CYCLIC_TORQUE = 10  # Mode of operation: cyclic synchronous torque


class State(Enum):
    """States of a drive, as its statusword encodes them."""

    NOT_READY = "not ready to switch on"
    SWITCH_ON_DISABLED = "switch on disabled"
    READY = "ready to switch on"
    SWITCHED_ON = "switched on"
    ENABLED = "operation enabled"
    QUICK_STOP = "quick stop active"
    FAULT_REACTION = "fault reaction active"
    FAULT = "fault"
    UNKNOWN = "unknown"


class Wanted(Enum):
    """Goals of a drive's state machine."""

    ENABLED = auto()
    RESET = auto()


MASKED_STATES = {
    0x4F: {
        0x00: State.NOT_READY,
        0x40: State.SWITCH_ON_DISABLED,
        0x0F: State.FAULT_REACTION,
        0x08: State.FAULT,
    },
    0x6F: {
        0x21: State.READY,
        0x23: State.SWITCHED_ON,
        0x27: State.ENABLED,
        0x07: State.QUICK_STOP,
    },
}
"""State by statusword under a mask."""

# Controlwords.
DISABLE_VOLTAGE = 0x00
SHUTDOWN = 0x06
_SWITCH_ON = 0x07
ENABLE = 0x0F
RESET = 0x80

CONTROLWORDS = {
    (State.SWITCH_ON_DISABLED, Wanted.ENABLED): SHUTDOWN,
    (State.READY, Wanted.ENABLED): _SWITCH_ON,
    (State.SWITCHED_ON, Wanted.ENABLED): ENABLE,
    (State.ENABLED, Wanted.ENABLED): ENABLE,
    (State.FAULT, Wanted.RESET): RESET,
}
"""The next controlword on the way to the wanted goal; for other pairs the voltage is disabled."""


def state_of(statusword: int) -> State:
    """Decodes the state from a statusword."""
    for mask, states in MASKED_STATES.items():
        if (state := states.get(statusword & mask)) is not None:
            return state
    return State.UNKNOWN


def next_controlword(statusword: int, wanted: Wanted) -> tuple[State, int]:
    """Returns the drive's state and the controlword of the next transition towards the wanted goal.

    A fault is reset for `Wanted.RESET` only, by the rising edge of bit 7: send the controlword of another goal first.
    A quick stop ends in `SWITCH_ON_DISABLED`, never directly in the enabled state.
    """
    state = state_of(statusword)
    return state, CONTROLWORDS.get((state, wanted), DISABLE_VOLTAGE)

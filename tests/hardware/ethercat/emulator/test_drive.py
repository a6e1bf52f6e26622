from hypothesis import given
from hypothesis import strategies as st

from stepgap.hardware.ethercat.emulator.drive import DriveState, next_drive_state

STATES = st.sampled_from(DriveState)
WORDS = st.integers(0, 0xFFFF)
UP = [
    DriveState.SWITCH_ON_DISABLED,
    DriveState.READY_TO_SWITCH_ON,
    DriveState.SWITCHED_ON,
    DriveState.OPERATION_ENABLED,
]


@given(STATES, WORDS, WORDS)
def test_states_go_up_one_at_a_time_and_only_on_request(state, controlword, before):
    after = next_drive_state(state, controlword, before)
    if state in UP and after in UP:
        assert UP.index(after) <= UP.index(state) + 1
    if after is DriveState.OPERATION_ENABLED:
        assert controlword & 0x0F == 0x0F
        assert state in (DriveState.SWITCHED_ON, DriveState.OPERATION_ENABLED)


@given(WORDS, WORDS)
def test_a_fault_is_left_by_a_rising_edge_of_bit_7_only(controlword, before):
    rises = controlword & 0x80 and not before & 0x80
    expected = DriveState.SWITCH_ON_DISABLED if rises else DriveState.FAULT
    assert next_drive_state(DriveState.FAULT, controlword, before) is expected

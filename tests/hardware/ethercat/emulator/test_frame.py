import pytest
from hypothesis import given
from hypothesis import strategies as st

from stepgap.hardware.ethercat.emulator.frame import (
    BROADCAST,
    SHORTEST_FRAME,
    Command,
    Datagram,
    Frame,
    FrameError,
    decode,
    encode,
)

WORDS = st.integers(0, 0xFFFF)
DATAGRAMS = st.builds(
    Datagram,
    st.integers(0, 255),
    st.integers(0, 255),
    WORDS,
    WORDS,
    st.binary(max_size=60),
    WORDS,
    st.integers(0, 15).map(lambda bits: bits << 11),
    WORDS,
)
FRAMES = st.builds(
    Frame,
    st.binary(min_size=6, max_size=6),
    st.binary(min_size=6, max_size=6),
    st.lists(DATAGRAMS, min_size=1, max_size=8).map(tuple),
)


@given(FRAMES)
def test_decoding_reverses_encoding(frame):
    raw = encode(frame)
    assert len(raw) >= SHORTEST_FRAME
    assert decode(raw) == frame


@given(FRAMES, st.data())
def test_a_truncated_frame_is_refused(frame, data):
    raw = encode(frame)
    length = 16 + int.from_bytes(raw[14:16], "little") % 0x800
    with pytest.raises(FrameError):
        decode(raw[: data.draw(st.integers(0, length - 1))])


def test_a_frame_of_the_standard():
    # a broadcast read of register 0, one byte
    raw = bytes.fromhex("ffffffffffff 101010101010 88a4 0d10 07 05 0000 0000 0100 0000 00 0000")
    assert encode(Frame(BROADCAST, b"\x10" * 6, (Datagram(Command.BRD, 5, 0, 0, b"\0"),))) == raw.ljust(60, b"\0")

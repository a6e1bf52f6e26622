"""Process data: unpacking reverses packing, and the length is always the same."""

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from stepgap.hardware.ethercat.pdo import ENTRY_FORMATS, SIGNED_VALUES, Entry, Packing, Pdo
from stepgap.hardware.ethercat.pdo_sets import PDO_SETS

ENTRIES = st.builds(
    Entry,
    st.integers(0, 0xFFFF),
    st.integers(0, 0xFF),
    st.sampled_from(list(ENTRY_FORMATS)),
    st.sampled_from(["", *SIGNED_VALUES]),
)
PDOS = st.lists(st.builds(Pdo, st.integers(0x1600, 0x17FF), st.lists(ENTRIES, max_size=4).map(tuple)), max_size=3).map(
    tuple
)


def test_a_drives_bytes_are_little_endian_and_in_order() -> None:
    elmo = PDO_SETS["elmo-cst"]
    values = {"target_torque": -2, "controlword": 0x800F, "mode": 10}
    assert Packing(elmo.outputs).pack(values) == bytes([0xFE, 0xFF, 0x0F, 0x80, 10, 0])
    data = struct.pack("<ihHbxi", -5, -6, 0x9237, 10, -7)
    assert Packing(elmo.inputs).unpack(data) == {
        "position": -5,
        "torque": -6,
        "statusword": 0x9237,
        "mode_display": 10,
        "velocity": -7,
    }


@given(PDOS, st.data())
def test_unpacking_reverses_packing(pdos: tuple[Pdo, ...], data: st.DataObject) -> None:
    names = [entry.name for pdo in pdos for entry in pdo.entries if entry.name]
    if len(set(names)) < len(names):
        with pytest.raises(ValueError, match="a value is mapped twice"):
            Packing(pdos)
        return
    packing, values = Packing(pdos), {}
    for name in names:
        bits = packing.mapping[name][0].bits
        low, high = (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1) if SIGNED_VALUES[name] else (0, 2**bits - 1)
        values[name] = data.draw(st.integers(low, high))
    packed = packing.pack(values)
    assert len(packed) == packing.size == sum(entry.bits for pdo in pdos for entry in pdo.entries) // 8
    assert packing.unpack(packed) == values
    with pytest.raises(struct.error):
        packing.unpack(packed + b"\0")
    for name, (entry, bit) in packing.mapping.items():
        lone = packing.pack({other: 0 if other != name else values[name] for other in names})
        rest = lone[: bit // 8] + lone[(bit + entry.bits) // 8 :]
        assert not any(rest), "a value touches its own bytes only"


@pytest.mark.parametrize(
    ("entries", "expected"),
    [
        ([Entry(0, 0, 4)], "4 bits, but they must fill bytes"),
        ([Entry(0, 0, 4), Entry(0x6041, 0, 16, "statusword"), Entry(0, 0, 4)], "starts at bit 4"),
    ],
)
def test_values_that_do_not_start_at_bytes_are_refused(entries: list[Entry], expected: str) -> None:
    with pytest.raises(ValueError, match=expected):
        Packing((Pdo(0x1A00, tuple(entries)),))


@given(ENTRIES)
def test_parsing_reverses_formatting(entry: Entry) -> None:
    assert Entry.parse(str(entry)) == entry

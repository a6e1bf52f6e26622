"""The text for a `rig.toml`: it can be pasted, and what it describes agrees with the ESI file."""

import tomllib
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stepgap.base.errors import InputError
from stepgap.base.settings_file import build
from stepgap.hardware.ethercat.esi.comparison import compare_with_esi
from stepgap.hardware.ethercat.esi.proposal import MOST_DEVICES, propose
from stepgap.hardware.ethercat.esi.reader import (
    EsiDevice,
    EsiEntry,
    EsiFile,
    EsiPdo,
    InitCommand,
    OpMode,
    read_esi,
    shorten,
)
from stepgap.hardware.ethercat.pdo import Packing, PdoSet
from stepgap.hardware.ethercat.pdo_sets import PDO_SETS
from stepgap.hardware.ethercat.rig_settings import Slave, WrittenPdoSet
from tests.hardware.ethercat.esi.esi_files import DRIVE, TERMINAL, written


def pasted(text: str) -> tuple[list[Slave], dict[str, PdoSet]]:
    """Slaves and sets of a `rig.toml` with this text, read as the rig reads them."""
    table: dict[str, Any] = tomllib.loads(text)
    slaves = [build(Slave, each, str) for each in table["slaves"]]
    sets = [build(WrittenPdoSet, each, str) for each in table.get("pdo_sets", [])]
    return slaves, {each.name: each.pdo_set() for each in sets}


def test_a_drive_gets_a_set_for_torque(tmp_path: Path) -> None:
    file = read_esi(written(tmp_path, DRIVE))
    text = propose(file)
    (slave,), sets = pasted(text)
    assert slave == Slave(
        name="SD-10",
        vendor=0xABC,
        product=0x1234,
        revision=0x20000,
        esi="drive.xml",
        pdos="sd-10-torque",
        startup=("0x2100:1A UINT16 = 65533", "0x2101:00 UINT8 = 1"),
        assign_activate=0x300,
    )
    assert list(sets) == ["sd-10-torque", "sd-10-default"]
    torque = sets["sd-10-torque"]
    assert Packing(torque.outputs).names == ("controlword", "target_torque", "mode")
    assert Packing(torque.inputs).names == ("statusword", "position", "torque")
    assert [pdo.index for pdo in torque.outputs] == [0x1601], "not the one with a target position"
    assert [pdo.index for pdo in torque.inputs] == [0x1A00, 0x1A01], "mandatory, and the torque"
    assert not any(each.is_error for each in compare_with_esi(slave, torque, file, 2.0))
    for comment in (
        "the file has 0x0300 DC (SYNC0), 0x0000 Free run",
        "the file has 2 revisions",
        "# Filter",
        "# startup cannot write 0x1C32:01 = 0200",
        "#   0x1602 Outputs of the drive: 0x60FE:01:32",
        "(PdoConfig)",
    ):
        assert comment in text


def test_what_cannot_be_exchanged_is_not_proposed(tmp_path: Path) -> None:
    text = propose(read_esi(written(tmp_path, TERMINAL)))
    (slave,), sets = pasted(text)
    assert (slave.pdos, sets) == ("none", {})
    assert "# The rig cannot exchange the PDOs after power-up: pdos: PDO 0x1A00 is in sync manager 0" in text
    assert "#   0x1A00 Inputs: 0x6000:01:8" in text


def test_numbers_with_a_fraction_have_no_names(tmp_path: Path) -> None:
    """The rig takes the bits of position, torque and target torque for whole numbers."""
    real = DRIVE
    for index in ("<Index>#x6071</Index>", "<Index>#x6064</Index>"):
        real = real.replace(index, f"{index}<DataType>REAL</DataType>")
    text = propose(read_esi(written(tmp_path, real)))
    (slave,), sets = pasted(text)
    assert slave.pdos == "sd-10-default"
    assert "position" not in Packing(sets[slave.pdos].inputs).names
    assert "(REAL, not used by the rig)" in text


@pytest.mark.parametrize(
    "name", [name for name, found in PDO_SETS.items() if "target_torque" in Packing(found.outputs).names]
)
def test_the_set_of_a_known_device_is_named(name: str) -> None:
    """The file of the device describes exactly this set."""
    found = PDO_SETS[name]
    directions = [
        tuple(
            EsiPdo(
                pdo.index,
                entries=tuple(EsiEntry(entry.index, entry.subindex, entry.bits) for entry in pdo.entries),
                fixed=True,
                sync_manager=manager,
            )
            for pdo in pdos
        )
        for pdos, manager in ((found.outputs, 2), (found.inputs, 3))
    ]
    device = EsiDevice("K", "", 1, 1, directions[0], directions[1], has_coe=True)
    text = propose(EsiFile("k.xml", 1, "", (device,)))
    (fitting,) = [line for line in text.splitlines() if "fit, too" in line]
    assert fitting.endswith(f": {name}")
    (slave,), sets = pasted(text)
    assert sets[slave.pdos] == found, "with the same names"


def test_one_of_many_devices_is_asked_for(tmp_path: Path) -> None:
    devices = tuple(EsiDevice(f"T{number}", "", number, 1) for number in range(MOST_DEVICES + 1))
    file = EsiFile("many.xml", 1, "Many", devices)
    listed = propose(file)
    assert "--product 0x00000014  T20" in listed
    assert "[[slaves]]" not in listed
    assert pasted(propose(file, "0x14"))[0][0].name == "T20"
    for wrong in ("0x99", "twenty", "-1"):
        with pytest.raises(InputError, match=f"--product {wrong}: many.xml has 0x00000000, .*, …$"):
            propose(file, wrong)
    with pytest.raises(InputError, match=r"m.xml: describes no device, only modules"):
        propose(EsiFile("m.xml", 1, "", ()))


TEXTS = st.text(st.characters(codec="utf-8", exclude_categories=["C"]), max_size=12).map(shorten)
OUTPUT_OBJECTS = {0x6040: 16, 0x6071: 16, 0x6060: 8, 0x607A: 32, 0x6072: 16, 0x2000: 64}
INPUT_OBJECTS = {0x6041: 16, 0x6064: 32, 0x6061: 8, 0x606C: 32, 0x6077: 16, 0x603F: 16, 0x2001: 8}
ODD_ENTRIES = st.builds(EsiEntry, st.sampled_from([0, 0x6040, 0x2002]), st.integers(0, 300), st.integers(1, 70), TEXTS)


def rarely(value: object, usual: object) -> st.SearchStrategy[Any]:
    """The usual value, and in one of eight cases the other one."""
    return st.integers(0, 7).map(lambda number: usual if number else value)


def pdos(first: int, manager: int, objects: dict[int, int]) -> st.SearchStrategy[tuple[EsiPdo, ...]]:
    """PDOs with objects of a drive, most of which the rig can exchange."""
    well_formed = st.lists(st.sampled_from(sorted(objects)), min_size=2, max_size=6, unique=True).map(
        lambda chosen: tuple(EsiEntry(index, 0, objects[index]) for index in chosen)
    )
    contents = st.integers(0, 7).flatmap(
        lambda number: well_formed if number else st.lists(ODD_ENTRIES, max_size=3).map(tuple)
    )
    one = st.builds(
        EsiPdo,
        st.integers(first, first + 3),
        TEXTS,
        contents,
        st.booleans(),
        rarely(True, False),
        st.sampled_from([None, manager]) | rarely(0, manager),
        rarely(frozenset({first, first + 1}), frozenset()),
        rarely(frozenset({manager}), frozenset()),
    )
    return st.lists(one, min_size=1, max_size=3, unique_by=lambda each: each.index).map(tuple)


COMMANDS = st.builds(
    InitCommand,
    st.sampled_from([("PS",), ("IP", "SO"), ("PI",)]),
    st.sampled_from([0x2000, 0x2001, 0x605A, 0x6060, 0x1C12, 0x1C32]),
    st.integers(0, 2),
    st.none() | st.binary(min_size=1, max_size=5),
    st.booleans(),
    st.booleans(),
    TEXTS,
)
DEVICES = st.builds(
    EsiDevice,
    kind=TEXTS,
    name=TEXTS,
    product=st.integers(0, 2**32 - 1),
    revision=st.integers(1, 2**32 - 1),
    outputs=pdos(0x1600, 2, OUTPUT_OBJECTS),
    inputs=pdos(0x1A00, 3, INPUT_OBJECTS),
    has_coe=rarely(False, True),
    pdo_assign=rarely(False, True),
    pdo_config=st.booleans(),
    init_commands=st.lists(COMMANDS, max_size=4, unique_by=lambda each: (each.index, each.subindex)).map(tuple),
    op_modes=st.lists(
        st.builds(OpMode, TEXTS, st.sampled_from([0, 0x300, 0x330, 0x700]), st.sampled_from([0, 250_000])), max_size=3
    ).map(tuple),
    safeop_op_timeout=st.floats(0, 100),
)


@settings(deadline=None, max_examples=80)
@given(DEVICES)
def test_what_is_proposed_can_be_pasted_and_contradicts_nothing(device: EsiDevice) -> None:
    file = EsiFile("any.xml", 7, "Any", (device,))
    (slave,), sets = pasted(propose(file))
    assert (slave.vendor, slave.product, slave.revision) == (7, device.product, device.revision)
    for pdo_set in sets.values():
        findings = compare_with_esi(slave, pdo_set, file, 2.0)
        assert not [each.text for each in findings if each.is_error]
    if slave.pdos == "none":
        errors = [each.text for each in compare_with_esi(slave, PdoSet(), file, 2.0) if each.is_error]
        assert all(error.startswith("pdos: ") for error in errors), "only that nothing can be exchanged"

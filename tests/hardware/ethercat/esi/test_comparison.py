"""What an ESI file says against a `rig.toml`: contradictions are errors, doubts are remarks."""

from dataclasses import replace
from pathlib import Path

import pytest

from stepgap.hardware.ethercat.esi.comparison import compare_with_esi
from stepgap.hardware.ethercat.esi.reader import EsiDevice, EsiEntry, EsiFile, EsiPdo, OpMode, read_esi
from stepgap.hardware.ethercat.pdo import Entry, Pdo, PdoSet
from stepgap.hardware.ethercat.rig_settings import Slave
from tests.hardware.ethercat.esi.esi_files import DRIVE, MODULAR, TERMINAL, written


def pdo(index: int, *entries: str) -> Pdo:
    return Pdo(index, tuple(map(Entry.parse, entries)))


CONTROL, TORQUE, MODE = "0x6040:00:16 controlword", "0x6071:00:16 target_torque", "0x6060:00:8 mode"
STATUS, POSITION = "0x6041:00:16 statusword", "0x6064:00:32 position"
PDOS = PdoSet((pdo(0x1601, CONTROL, TORQUE, MODE, "0x0000:00:8"),), (pdo(0x1A00, STATUS, POSITION),))
SLAVE = Slave(
    name="drive",
    vendor=0xABC,
    product=0x1234,
    revision=0x20000,
    assign_activate=0x300,
    startup=("0x2100:1A INT16 = -3", "0x2101:00 UINT8 = 1"),
)
DOUBTS = (
    "the file writes 0200 to 0x1C32:01, which startup cannot do",
    "the device may take 9 s to reach OP; the rig waits for 2 s",
    "the control byte 0x24 of the outputs enables no watchdog; the proof of the watchdog on the drive counts",
    "the file lists no option code 0x6007 (when frames end), 0x605A (after a quick stop), 0x605C (when it is disabled)"
    ": read in the manual what the drive does",
)
"""What is doubtful about the drive in any case."""


@pytest.fixture
def drive(tmp_path: Path) -> EsiFile:
    return read_esi(written(tmp_path, DRIVE))


def found(slave: Slave, pdos: PdoSet, file: EsiFile, revision: int | None = None) -> tuple[list[str], list[str]]:
    """Errors, and remarks besides `DOUBTS`."""
    findings = compare_with_esi(slave, pdos, file, 2.0, revision)
    remarks = [each.text for each in findings if not each.is_error and each.text not in DOUBTS]
    return [each.text for each in findings if each.is_error], remarks


def changed(file: EsiFile, **changes: object) -> EsiFile:
    """The file with another last device."""
    return replace(file, devices=(*file.devices[:-1], replace(file.devices[-1], **changes)))


def test_settings_that_agree_have_no_errors(drive: EsiFile) -> None:
    findings = compare_with_esi(SLAVE, PDOS, drive, 2.0)
    assert [each.text for each in findings] == list(DOUBTS)
    assert not any(each.is_error for each in findings)


@pytest.mark.parametrize(
    ("changes", "errors"),
    [
        ({"vendor": 0xABD}, ["vendor = 0x00000ABD, but the file is that of vendor 0x00000ABC, Example Drives"]),
        ({"product": 0x1235}, ["product = 0x00001235, but the file describes 0x00001234"]),
        ({"revision": 0x20001}, ["revision = 0x00020001, but the file describes 0x00010000, 0x00020000"]),
        ({"assign_activate": 0x700}, ["assign_activate = 0x0700, but the OpModes of the file are DC (SYNC0) 0x0300, "]),
        (
            {"startup": ("0x2100:1A INT16 = -3",)},
            ['startup: the file writes 0x2101:00, which is missing; add "0x2101:00 UINT8 = 1"'],
        ),
        (
            {"startup": ("0x2101:00 UINT8 = 1", "0x2100:1A INT16 = 3")},
            ["startup has '0x2100:1A INT16 = 3', but the file writes fdff to 0x2100:1A (Filter)"],
        ),
    ],
)
def test_what_differs_is_an_error(drive: EsiFile, changes: dict[str, object], errors: list[str]) -> None:
    texts, _ = found(replace(SLAVE, **changes), PDOS, drive)
    assert len(texts) == len(errors)
    assert all(text.startswith(error) for text, error in zip(texts, errors, strict=True))


@pytest.mark.parametrize(
    ("outputs", "inputs", "errors"),
    [
        ((pdo(0x1655, CONTROL),), PDOS.inputs, ["pdos: there is no PDO 0x1655 among the outputs, which are"]),
        (
            (pdo(0x1600, CONTROL, "0x607A:00:32"), pdo(0x1601, "0x0000:00:16", TORQUE, MODE, "0x0000:00:8")),
            PDOS.inputs,
            ["pdos: PDOs 0x1600 and 0x1601 cannot be exchanged together (Exclude)"],
        ),
        ((*PDOS.outputs, pdo(0x1602, "0x60FE:01:32")), PDOS.inputs, ["pdos: PDO 0x1602 cannot be in sync manager 2"]),
        (PDOS.outputs, (pdo(0x1A01, "0x6077:00:16 torque"),), ["pdos: PDO 0x1A00 (Actual values) is mandatory among"]),
        (PDOS.outputs, (pdo(0x1A00, POSITION, STATUS),), ["pdos: PDO 0x1A00 has 0x6064:00:32 position at bit 0, but"]),
        (PDOS.outputs, (pdo(0x1A00, STATUS),), ["pdos: PDO 0x1A00 has 16 bits, but 48 according to the file"]),
        ((), PDOS.inputs, ["pdos: there are no outputs, but the device exchanges 0x1600 unless a master changes this"]),
    ],
)  # fmt: skip
def test_pdos_that_the_device_cannot_exchange_are_errors(
    drive: EsiFile, outputs: tuple[Pdo, ...], inputs: tuple[Pdo, ...], errors: list[str]
) -> None:
    texts, _ = found(SLAVE, PdoSet(outputs, inputs), drive)
    assert len(texts) == len(errors), texts
    assert all(text.startswith(error) for text, error in zip(texts, errors, strict=True)), texts


def test_contents_that_can_be_written_are_a_remark_and_others_an_error(drive: EsiFile) -> None:
    own = PdoSet((pdo(0x1601, TORQUE, CONTROL),), PDOS.inputs)
    difference = "pdos: PDO 0x1601 has 0x6071:00:16 target_torque at bit 0, but 0x6040:00:16 according to the file"
    assert found(SLAVE, own, drive) == ([], [f"{difference}; the rig writes the contents of rig.toml"])
    reason = "its contents cannot be written (PdoConfig)"
    assert found(SLAVE, own, changed(drive, pdo_config=False)) == ([f"{difference}, and {reason}"], [])


def test_an_assignment_that_cannot_be_changed_must_be_that_after_power_up(drive: EsiFile) -> None:
    rigid = changed(drive, pdo_assign=False)
    texts, _ = found(SLAVE, PDOS, rigid)
    assert texts == [
        "pdos: the outputs are 0x1601, but 0x1600 according to the file, "
        "and the assignment cannot be changed (PdoAssign)"
    ]
    default = PdoSet((pdo(0x1600, CONTROL, "0x607A:00:32"),), PDOS.inputs)
    assert found(SLAVE, default, rigid)[0] == []


def test_a_status_word_of_single_bits_may_be_written_as_padding() -> None:
    entries = (*(EsiEntry(0x6000, number, 1) for number in range(1, 17)), EsiEntry(0x6000, 0x11, 16))
    device = EsiDevice(
        "T", "T", 1, 0, inputs=(EsiPdo(0x1A00, entries=entries, sync_manager=3, fixed=True),), has_coe=True
    )
    file = EsiFile("t.xml", 2, "", (device,))
    slave = Slave(name="force", vendor=2, product=1)
    set_of = PdoSet((), (pdo(0x1A00, "0x0000:00:16 status", "0x6000:11:16 force"),))
    assert compare_with_esi(slave, set_of, file, 2.0) == []
    assert found(slave, PdoSet((), (pdo(0x1A00, "0x0000:00:16 status", "0x6000:12:16 force"),)), file)[0]


def test_a_device_without_mailbox_and_with_another_sync_manager(tmp_path: Path) -> None:
    terminal = read_esi(written(tmp_path, TERMINAL))
    slave = Slave(name="inputs", vendor=2, product=0x12345678)
    inputs = PdoSet((), (pdo(0x1A00, "0x6000:01:8"),))
    assert found(slave, inputs, terminal)[0] == [
        "pdos: PDO 0x1A00 is in sync manager 0, not in sync manager 3, to which the rig assigns it",
        "pdos: according to the file the device has no CoE, without which PDOs cannot be checked",
    ]
    assert "the device exchanges 0x1A00" in found(slave, PdoSet(), terminal)[0][0]


def test_pdos_of_modules_count(tmp_path: Path) -> None:
    modular = read_esi(written(tmp_path, MODULAR))
    slave = Slave(name="axis", vendor=0xABD, product=7, revision=1)
    good = PdoSet((pdo(0x1600, CONTROL, TORQUE),), (pdo(0x1A00, STATUS, POSITION),))
    doubt = "modules of the file have start-up objects of their own; compare them with startup"
    assert found(slave, good, modular) == ([], [doubt])
    wrong = PdoSet((pdo(0x1600, TORQUE, CONTROL),), (pdo(0x1A00, STATUS, POSITION),))
    (error,) = found(slave, wrong, modular)[0]
    assert error.endswith("0x6040:00:16 according to the file, and its contents are fixed")


@pytest.mark.parametrize(
    ("modes", "wanted", "errors", "remarks"),
    [
        ((), 0, 0, 0),
        ((), 0x300, 1, 0),
        ((OpMode("DC", 0x300),), 0, 1, 0),
        ((OpMode("DC", 0x300), OpMode("SM", 0)), 0, 0, 1),
        ((OpMode("SM", 0), OpMode("DC", 0x300)), 0x300, 0, 1),
        ((OpMode("DC", 0x330),), 0x300, 0, 1),
        ((OpMode("DC", 0x700), OpMode("DC01", 0x700)), 0x700, 0, 0),
        ((OpMode("DC", 0x300, cycle=250_000),), 0x300, 0, 1),
    ],
)
def test_distributed_clocks(drive: EsiFile, modes: tuple[OpMode, ...], wanted: int, errors: int, remarks: int) -> None:
    texts = found(replace(SLAVE, assign_activate=wanted), PDOS, changed(drive, op_modes=modes))
    assert tuple(map(len, texts)) == (errors, remarks)
    assert all(text.startswith(("assign_activate", "the file")) for each in texts for text in each)


def test_the_revision_on_the_bus_is_compared(drive: EsiFile) -> None:
    unknown = replace(SLAVE, revision=0)
    assert found(unknown, PDOS, drive)[1][0].endswith("the last one is compared: give revision in rig.toml")
    assert found(unknown, PDOS, drive, 0x20000) == ([], [])
    newer = found(unknown, PDOS, drive, 0x20005)
    assert newer == (
        [],
        [
            "the device has revision 0x00020005, but the file describes 0x00010000, 0x00020000; "
            "get the file of this revision"
        ],
    )
    first, _ = found(unknown, PDOS, drive, 0x10000)
    assert any("there is no PDO 0x1601" in text for text in first), "the first revision has other PDOs"


def test_objects_that_the_rig_needs(drive: EsiFile) -> None:
    _, remarks = found(SLAVE, PDOS, changed(drive, objects=drive.devices[-1].objects - {0x6076}))
    assert remarks == ["the file lists no object 0x6076, the rated torque, which the rig needs"]


@pytest.mark.parametrize("fixed", [False, True])
def test_a_number_with_a_fraction_is_no_value_for_the_rig(fixed: bool, drive: EsiFile) -> None:
    outputs = [
        replace(each, fixed=fixed, entries=tuple(replace(entry, is_real=True) for entry in each.entries))
        for each in drive.devices[-1].outputs
    ]
    errors, _ = found(SLAVE, PDOS, changed(drive, outputs=tuple(outputs)))
    assert [text.split(" is ")[0] for text in errors] == [f"pdos: {entry}" for entry in (CONTROL, TORQUE, MODE)]
    assert errors[0].endswith("is a REAL according to the file, and the rig has whole numbers only")


def test_a_file_that_names_no_objects_is_compared_by_sizes(drive: EsiFile) -> None:
    nameless = EsiPdo(0x1A00, "In", (EsiEntry(0x1A00, 1, 16), EsiEntry(0x1A00, 2, 32)), True, True, 3)
    _, remarks = found(SLAVE, PDOS, changed(drive, inputs=(nameless,)))
    assert remarks == ["pdos: the file does not say which objects PDO 0x1A00 has; only their sizes are compared"]
    smaller = replace(nameless, entries=nameless.entries[:1])
    assert "no entry according to the file" in found(SLAVE, PDOS, changed(drive, inputs=(smaller,)))[0][0]

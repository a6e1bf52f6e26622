"""Objects that are written before the start: their texts, and drives that refuse, lack or do not keep them."""

from contextlib import suppress
from dataclasses import replace
from struct import Struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from stepgap.hardware.ethercat.drive_setup import REACTIONS, secure_reactions
from stepgap.hardware.ethercat.drive_watch import NO_STO_INPUT
from stepgap.hardware.ethercat.emulator.drive import ABORT_CONNECTION, OPTION_CODES, Drive, DriveSettings
from stepgap.hardware.ethercat.emulator.frame import Command, decode
from stepgap.hardware.ethercat.emulator.registers import SYNC_MANAGER
from stepgap.hardware.ethercat.ethercat_rig import EthercatRig
from stepgap.hardware.ethercat.rig_settings import Slave
from stepgap.hardware.ethercat.startup import LAYOUTS, StartupObject
from stepgap.rigs.rig import MissingObject, RigFault
from tests.hardware.ethercat.ring_process import Recorder, live_ring

INTEGERS = [kind for kind in LAYOUTS if kind != "REAL32"]


@given(st.integers(0x1000, 0x15FF), st.integers(0, 0xFE), st.sampled_from(INTEGERS), st.data())
def test_an_object_is_read_as_it_is_written(index: int, subindex: int, kind: str, data: st.DataObject):
    bits = int("".join(filter(str.isdigit, kind)))
    low, high = (0, 2**bits - 1) if kind.startswith("U") else (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)
    value = data.draw(st.integers(low, high))
    wanted = StartupObject(index, subindex, kind, value)
    assert StartupObject.parse(f"0x{index:04x}:{subindex:02X} {kind.lower()} = {value}") == wanted
    assert StartupObject.parse(f"0x{index:04x}:{subindex:02X} {kind}={value:#x}") == wanted
    for beyond in (low - 1, high + 1):
        with pytest.raises(ValueError, match=f"is not a number that fits {kind}"):
            StartupObject.parse(f"0x{index:04x}:{subindex:02X} {kind} = {beyond}")


@given(st.text(max_size=40))
def test_any_other_text_is_refused(text: str):
    with suppress(ValueError):
        StartupObject.parse(text)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("3034 UINT16 = 5", "write it as '0x3034:00 UINT16 = 5'"),
        ("0x3034:00 UINT16 = five", "five is not a number that fits UINT16"),
        ("0x3034:00 UINT16 = 2.5", "2.5 is not a number that fits UINT16"),
        ("0x3034:00 UINT64 = 5", "UINT64 is not a type; these are INT8"),
        ("0x3034:00 REAL32 = 1e99", "1e99 is not a number that fits REAL32"),
        ("0x1C12:00 UINT8 = 0", "0x1C12 is set by the master"),
        ("0x1602:01 UINT32 = 0", "0x1602 is set by the master"),
        ("0x6060:00 INT8 = 8", "0x6060 is set by the master"),
        ("0x6072:00 UINT16 = 9", "0x6072 is set by the master"),
    ],
)
def test_what_is_wrong_is_said(text: str, message: str):
    with pytest.raises(ValueError, match=message):
        StartupObject.parse(text)
    with pytest.raises(ValueError, match="startup = "):
        Slave(name="drive", vendor=1, product=2, startup=(text,))


def test_an_object_is_given_once():
    with pytest.raises(ValueError, match="name each object once"):
        Slave(name="drive", vendor=1, product=2, startup=("0x3034:00 UINT16 = 5", "0x3034:00 INT8 = 6"))


class DriveObjects:
    """The objects of an emulated drive, some of which it lacks, or does not keep."""

    def __init__(self, lacking: tuple[int, ...] = (), stubborn: tuple[int, ...] = ()):
        self.drive = Drive("drive", DriveSettings(abort_connection=0, ramps=2), lambda _: 0.0)
        self._lacking, self._stubborn, self.written = lacking, stubborn, list[int]()

    def label(self, number: int) -> str:
        return f"slave {number + 1}"

    def read_object(self, _: int, index: int, layout: Struct, subindex: int = 0) -> int:
        if index in self._lacking:
            raise MissingObject(f"{index:04X}")
        return layout.unpack(self.drive.dictionary.read(index, subindex))[0]

    def write_object(self, _: int, index: int, layout: Struct, value: float, subindex: int = 0) -> None:
        self.written.append(index)
        if index not in self._stubborn:
            self.drive.dictionary.write(index, subindex, layout.pack(value), may_assign=True)


def test_every_reaction_of_a_drive_ends_torque():
    objects = DriveObjects()
    assert secure_reactions(objects, 0) == []
    for reaction in REACTIONS:
        assert objects.read_object(0, reaction.index, Struct("<h")) == reaction.without_torque[0]
    assert objects.written == [ABORT_CONNECTION, *OPTION_CODES]
    objects.written.clear()
    assert secure_reactions(objects, 0) == []
    assert objects.written == [], "what is right is left alone"


def test_missing_reactions_are_remarked_and_others_still_set():
    objects = DriveObjects(lacking=(0x605B, 0x605E))
    remarks = secure_reactions(objects, 1)
    assert ["0x605B" in remarks[0], "0x605E" in remarks[1], len(remarks)] == [True, True, 2]
    assert "slave 2 lacks object 0x605E: what it does after a fault is the setting of its factory" in remarks
    assert objects.written == [ABORT_CONNECTION, 0x605A, 0x605C]


def test_a_drive_that_does_not_keep_a_reaction_is_refused():
    with pytest.raises(RigFault, match="slave 1: object 0x605A:00 is 2 after 0 was written"):
        secure_reactions(DriveObjects(stubborn=(0x605A,)), 0)


# On the ring


def rig(**slave: object) -> EthercatRig:
    """A rig whose first drive has other settings."""
    from tests.hardware.ethercat.test_ethercat_rig import SETTINGS, rig_of

    first, *others = SETTINGS.slaves
    return rig_of(replace(SETTINGS, slaves=(replace(first, **slave), *others)))


def test_start_up_objects_and_reactions_reach_the_drives():
    pytest.importorskip("pysoem", reason="pysoem is locked for Linux only")
    with live_ring(make_machine=Recorder), rig(startup=("0x605A:00 INT16 = 2",), name="drive_1") as connected:
        read = connected._bus.read_object
        for number in (0, 1):
            assert [read(number, each.index, Struct("<h")) for each in REACTIONS] == [1, 0, 0, 0, 0]
        assert connected.remarks == (NO_STO_INPUT,)


class LosesPolls:
    """Loses every 40th frame that asks a slave whether it has taken the last request out of its mailbox."""

    def __init__(self) -> None:
        self._polls = 0

    def __call__(self, frame: bytes) -> bool:
        first = decode(frame).datagrams[0]
        is_poll = (first.command, first.offset) == (Command.FPRD, SYNC_MANAGER + 5)
        self._polls += is_poll
        return is_poll and self._polls % 40 == 0


def test_a_lost_frame_of_an_sdo_transfer_is_sent_again():
    pytest.importorskip("pysoem", reason="pysoem is locked for Linux only")
    with live_ring(is_lost=LosesPolls()), rig() as connected:
        assert connected.remarks == (NO_STO_INPUT,)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("0x3034:00 UINT16 = 5", r"slave 1 'drive_1': object 0x3034:00 is refused: 0x06020000"),
        ("0x6041:00 UINT16 = 5", r"slave 1 'drive_1': object 0x6041:00 is refused: 0x06010002"),
        ("0x605A:00 INT16 = 9", r"slave 1 'drive_1': object 0x605A:00 is refused: 0x06090030"),
    ],
)
def test_a_start_up_object_that_is_refused_is_named(text: str, message: str):
    pytest.importorskip("pysoem", reason="pysoem is locked for Linux only")
    with live_ring(make_machine=Recorder), pytest.raises(RigFault, match=message), rig(startup=(text,)):
        pass


def test_a_mode_that_is_not_in_the_process_data_is_set_by_sdo():
    pytest.importorskip("pysoem", reason="pysoem is locked for Linux only")
    from stepgap.hardware.ethercat.rig_settings import WrittenPdo, WrittenPdoSet
    from tests.hardware.ethercat.test_ethercat_rig import SETTINGS, rig_of

    short = WrittenPdoSet(
        name="short",
        outputs=(WrittenPdo(index=0x1602, entries=("0x6071:00:16 target_torque", "0x6040:00:16 controlword")),),
        inputs=(
            WrittenPdo(
                index=0x1A02,
                entries=(
                    "0x6064:00:32 position",
                    "0x6077:00:16",
                    "0x6041:00:16 statusword",
                    "0x6061:00:8",
                    "0x0000:00:8",
                ),
            ),
        ),
    )
    first, *others = SETTINGS.slaves
    settings = replace(SETTINGS, pdo_sets=(short,), slaves=(replace(first, pdos="short"), *others))
    with live_ring(make_machine=Recorder) as ring, rig_of(settings) as connected:
        for _ in range(5):
            connected.read()
            connected.write((2.0, 3.0))
        assert connected._bus.read_object(0, 0x6061, Struct("<b")) == 10
        assert ring.look().torques[-1][0] == pytest.approx(2.0, abs=0.02)

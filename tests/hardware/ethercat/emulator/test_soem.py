"""What SOEM reads and writes apart from process data: objects, their refusals, and the EEPROM."""

from struct import iter_unpack, pack, unpack_from
from typing import Any

import pytest

from tests.hardware.ethercat.emulator.bench import LENGTHS
from tests.hardware.ethercat.emulator.soem_master import pysoem, soem_master
from tests.hardware.ethercat.ring_process import INTERFACE, live_ring

STRINGS, GENERAL, FMMUS, SYNC_MANAGERS = 10, 30, 40, 41


def refusal(call: Any, *arguments: Any) -> int:
    """The code with which a slave aborts an SDO."""
    with pytest.raises(pysoem.SdoError) as refused:
        call(*arguments)
    return refused.value.abort_code


def categories(slave: Any) -> dict[int, bytes]:
    """Contents of the categories of an EEPROM, which begin at word 0x40 (ETG.2010)."""
    found, word = {}, 0x40
    while True:
        kind, length = unpack_from("<HH", slave.eeprom_read(word))
        if kind == 0xFFFF:
            return found
        words = b"".join(slave.eeprom_read(word + 2 + offset) for offset in range(0, length, 2))
        found[kind] = words[: 2 * length]
        word += 2 + length


def test_soem_reads_the_eeproms_and_objects_and_is_refused_what_it_may_not_do():
    with live_ring(), soem_master(INTERFACE) as bus:
        for slave, lengths in zip(bus.slaves, LENGTHS, strict=True):
            check_eeprom(slave, any(lengths))
        drive = bus.slaves[0]
        before = drive.eeprom_read(0x10)
        with pytest.raises(pysoem.EepromError):
            drive.eeprom_write(0x10, b"\1\2")
        assert drive.eeprom_read(0x10) == before
        check_objects(drive)
        check_refusals(drive)


def check_eeprom(slave: Any, has_mailbox: bool) -> None:
    identity = b"".join(slave.eeprom_read(word) for word in (0x08, 0x0A, 0x0C))
    assert identity == pack("<III", slave.man, slave.id, slave.rev)
    found = categories(slave)
    text = found[STRINGS]
    assert (text[0], text[2 : 2 + text[1]]) == (1, slave.name.encode())
    assert len(found[GENERAL]) == 32
    if not has_mailbox:  # the coupler
        assert found.keys() == {STRINGS, GENERAL}
        return
    assert found[GENERAL][5] == 0x05  # SDO, and PDOs may be assigned; neither complete access nor information
    assert found[FMMUS] == b"\1\2"
    areas = iter_unpack("<HHBBBB", found[SYNC_MANAGERS])
    assert [(start, use) for start, _, _, _, _, use in areas] == [(0x1000, 1), (0x1080, 2), (0x1100, 3), (0x1180, 4)]


def check_objects(drive: Any) -> None:
    assert [drive.sdo_read(*entry) for entry in ((0x1C00, 4), (0x1C12, 2), (0x1018, 2), (0x1008, 0))] == [
        b"\4",
        b"\x0b\x16",
        pack("<I", 0x30924),
        b"Gold drive",  # more than four bytes: not expedited
    ]
    for index, value in ((0x6060, b"\x0a"), (0x6072, pack("<H", 1234)), (0x6071, pack("<h", -5))):
        drive.sdo_write(index, 0, value)
        assert drive.sdo_read(index, 0) == value


def check_refusals(drive: Any) -> None:
    read, write = drive.sdo_read, drive.sdo_write
    assert refusal(read, 0x1018, 9) == 0x06090011
    assert [refusal(write, 0x6072, 0, bytes(size)) for size in (1, 4, 8, 200)] == [0x06070010] * 4  # 200: segmented
    # complete access is not offered in the EEPROM
    assert [refusal(read, 0x1018, subindex, 64, True) for subindex in (0, 1)] == [0x06010000] * 2
    assert refusal(write, 0x1C12, 0, b"\1\0\x0b\x16", True) == 0x06010000
    assert read(0x1C12, 0) + read(0x1C12, 1) == b"\2\x02\x16"  # as before
    with pytest.raises(pysoem.SdoInfoError):
        _ = drive.od

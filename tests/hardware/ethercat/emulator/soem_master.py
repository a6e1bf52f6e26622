"""SOEM (pysoem) as a master of tests."""

from collections.abc import Iterator
from contextlib import contextmanager
from struct import pack
from typing import Any

import pytest

from tests.hardware.ethercat.emulator.bench import DRIVE_INPUT, DRIVE_OUTPUT, DRIVES, LENGTHS

SAFEOP, OP, ERROR = 4, 8, 0x10
LONGEST_RUN = 100_000
TIMEOUT = 50_000
"""Longest wait for a frame [µs]; a lost one costs it."""
PATIENCE = 5_000_000
"""The same where each frame must make one tick, also on a busy computer."""

pysoem: Any = pytest.importorskip("pysoem", reason="the master of these tests is missing: pip install pysoem")


@contextmanager
def soem_master(interface: str) -> Iterator[Any]:
    """SOEM on a ring, its slaves found, the drives' PDOs assigned; it collects the codes of emergencies."""
    bus = pysoem.Master()
    bus.open(interface)
    try:
        assert bus.config_init() == len(LENGTHS)
        bus.emergencies = []
        for slave in bus.slaves:
            slave.add_emergency_callback(lambda message: bus.emergencies.append(message.error_code))
        for drive in DRIVES:
            assign(bus.slaves[drive], 0x1C12, 0x1602, 0x160B)
            assign(bus.slaves[drive], 0x1C13, 0x1A02, 0x1A11)
        yield bus
    finally:
        bus.close()


def assign(slave: Any, index: int, *pdos: int) -> None:
    slave.sdo_write(index, 0, b"\0")
    for number, pdo in enumerate(pdos, 1):
        slave.sdo_write(index, number, pack("<H", pdo))
    slave.sdo_write(index, 0, bytes([len(pdos)]))


def operational(bus: Any) -> Any:
    bus.config_map()
    assert bus.state_check(SAFEOP, TIMEOUT) == SAFEOP
    bus.config_dc()
    assert cycle(bus, control=0) == bus.expected_wkc
    bus.state = OP
    bus.write_state()
    assert bus.state_check(OP, TIMEOUT) == OP
    return bus


def cycle(bus: Any, torque_1: int = 0, torque_2: int = 0, control: int = 0x0F, timeout: int = TIMEOUT) -> int:
    """Working counter of one cycle; -1 for a lost frame."""
    for drive, torque in zip(DRIVES, (torque_1, torque_2), strict=True):
        bus.slaves[drive].output = DRIVE_OUTPUT.pack(torque, control, 10)
    bus.send_processdata()
    return bus.receive_processdata(timeout)


def enabled(bus: Any) -> Any:
    operational(bus)
    for control, state in ((0x06, 0x21), (0x07, 0x23), (0x0F, 0x27)):
        for _ in range(LONGEST_RUN):  # a drive acts on the controlword once a tick
            cycle(bus, control=control, timeout=PATIENCE)
            if [statusword(bus, drive) & 0x6F for drive in DRIVES] == [state] * 2:
                break
    return bus


def statusword(bus: Any, drive: int) -> int:
    return DRIVE_INPUT.unpack(bus.slaves[drive].input)[2]


def states(bus: Any) -> list[tuple[int, int]]:
    bus.read_state()
    return [(slave.state, slave.al_status) for slave in bus.slaves]

"""KickCAT as a master of tests: an EtherCAT master in C++ that shares no code with SOEM."""

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from importlib import import_module
from struct import pack
from typing import Any

import pytest

from tests.hardware.ethercat.emulator.bench import DRIVE_OUTPUT, DRIVES

WATCHDOG = 0.1
"""Watchdog of the process data that it sets [s]."""

_PATIENCES = (0.003, 0.003, 0.01, 0.1)
"""Longest waits for a frame [s], one attempt after the other, since a frame may be late if the computer has other work.

Where nothing is at its second port, KickCAT waits as long after each broadcast.
"""

_PRIORITY = 50
"""Priority of SCHED_FIFO, below the ring's."""

_LONG = 10.0
"""The same for frames that are no broadcasts, and for changes of state; never reached unless something is wrong."""


class KickcatMaster:
    """KickCAT on a ring, its slaves found and in PREOP."""

    def __init__(self, interface: str):
        try:
            self.kickcat: Any = import_module("kickcat")
        except ImportError:
            pytest.skip("the master of this test is missing: pip install kickcat (Linux on x86_64 or aarch64)")
        self._insist(lambda: self._begin(interface))
        self.slaves: list[Any] = self.bus.slaves()

    def _begin(self, interface: str) -> None:
        self._link = self.kickcat.create_link(interface, "")
        self._link.set_timeout(self._patience)
        self.bus: Any = self.kickcat.Bus(self._link)
        self.bus.init(WATCHDOG)

    def _insist(self, broadcast: Callable[[], None]) -> None:
        """Calls a function that broadcasts, again where frames were late."""
        for attempt, self._patience in enumerate(_PATIENCES, 1):
            try:
                with _first_of_all():
                    broadcast()
            except RuntimeError:
                if attempt == len(_PATIENCES):
                    raise
            else:
                break
        self._link.set_timeout(_LONG)

    def assign_pdos(self) -> None:
        for drive in DRIVES:
            for index, pdos in ((0x1C12, (0x1602, 0x160B)), (0x1C13, (0x1A02, 0x1A11))):
                entries = [
                    (0, b"\0"),
                    *((n, pack("<H", pdo)) for n, pdo in enumerate(pdos, 1)),
                    (0, bytes([len(pdos)])),
                ]
                assert [self.write(drive, index, subindex, value) for subindex, value in entries] == [0] * len(entries)

    def write(
        self, slave: int, index: int, subindex: int, value: bytes, complete: bool = False, wait: float = _LONG
    ) -> int:
        """Status of a download: 0 is done."""
        return self._status(self.slaves[slave].mailbox.write_sdo(index, subindex, complete, value, wait))

    def upload(
        self, slave: int, index: int, subindex: int, complete: bool = False, wait: float = _LONG
    ) -> tuple[int, bytes]:
        """Status and value of an upload."""
        message = self.slaves[slave].mailbox.read_sdo(index, subindex, complete, wait)
        status = self._status(message)
        return status, bytes(message.data[: message.size])

    def _status(self, message: Any) -> int:
        while message.status() == self.kickcat.mailbox.request.MessageStatus.RUNNING:
            self.bus.process_mailboxes()
        return message.status()

    def operational(self) -> None:
        self.bus.create_mapping()
        self.change(self.kickcat.State.SAFE_OP)
        self.cycle(control=0)
        self.change(self.kickcat.State.OPERATIONAL, self.bus.process_data_no_check)

    def change(self, state: Any, meanwhile: Callable[[], None] = lambda: None) -> None:
        self._insist(lambda: self._request(state))
        self.bus.wait_for_state(state, _LONG, meanwhile)

    def _request(self, state: Any) -> None:
        self._link.set_timeout(self._patience)
        self.bus.request_state(state)

    def enable(self) -> None:
        """The drives are enabled and without torque; the next tick is the second of the machine."""
        for control in (0x06, 0x07, 0x0F):
            self.cycle(control=control)

    def cycle(
        self, torque_1: int = 0, torque_2: int = 0, control: int = 0x0F, wait: float = _LONG, checked: bool = True
    ) -> None:
        """Reads all inputs with one frame, then writes all outputs with another.

        If `checked`, KickCAT raises RuntimeError where frames or slaves are lost, after a failed read before it writes.
        """
        self._link.set_timeout(wait)
        for drive, torque in zip(DRIVES, (torque_1, torque_2), strict=True):
            self.slaves[drive].set_output_bytes(DRIVE_OUTPUT.pack(torque, control, 10))
        try:
            (self.bus.process_data if checked else self.bus.process_data_no_check)()
        finally:
            self._link.set_timeout(_LONG)


@contextmanager
def _first_of_all() -> Iterator[None]:
    """This thread runs before others, if that is allowed."""
    with suppress(PermissionError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(_PRIORITY))
    try:
        yield
    finally:
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))

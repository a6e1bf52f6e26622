"""Start of distributed clocks: SYNC0 of the slaves in PREOP, agreement of all clocks in SAFEOP."""

from collections.abc import Callable
from struct import Struct
from typing import Any

from stepgap.hardware.ethercat.distributed_clocks import SYNC0_AND_SYNC1, Steering
from stepgap.hardware.ethercat.rig_settings import BusSettings, Slave
from stepgap.rigs.rig import RigFault

START_TIME = 0.15  # Time after which SYNC0 of every slave has begun [s]; SOEM lets it begin 0.1 s after its activation
LOCK_TIME = 5.0  # Longest time in which frames and clocks must be synchronised [s]
SYNCHRONOUS = 10_000  # Largest difference of a slave's clock from the reference clock before OP [ns]
_ATTEMPTS = 5  # Number of attempts to activate SYNC0, since a reply may be late on a busy computer

# Registers of a slave controller: the mean difference of its clock from the reference clock, and those of SYNC0.
_DIFFERENCE = 0x092C
_ACTIVATION = 0x0981
_START = 0x0990
_CYCLE = 0x09A0

_U32 = Struct("<I")
_U64 = Struct("<Q")


def start_clocks(master: Any, settings: BusSettings, label: Callable[[int], str]) -> None:
    """Measures delays, sets the offsets of all clocks and activates SYNC0, in PREOP, by the master of pysoem.

    Raises:
        RigFault: There is no distributed clock, or a slave does not take over its SYNC0.
    """
    if settings.uses_clocks and not master.config_dc():
        raise RigFault("no slave has distributed clocks, but the settings have assign_activate")
    for number, slave in enumerate(settings.slaves):
        if slave.assign_activate and not _activate(master.slaves[number], slave, settings.cycle):
            raise RigFault(f"{label(number)}: SYNC0 cannot be activated; it may have no distributed clock")


def synchronise(
    master: Any, settings: BusSettings, label: Callable[[int], str], steering: Steering, exchange: Callable[[], None]
) -> None:
    """Exchanges frames in SAFEOP until they, and the slaves' clocks, agree with the reference clock.

    Raises:
        RigFault: They do not agree within `LOCK_TIME`.
    """
    now = steering.host.now
    began = now()
    while not (steering.is_locked and now() > began + START_TIME and not _deviating(master, settings, label)):
        exchange()
        steering.wait()
        if now() > began + LOCK_TIME:
            late = f"the last frame was {1e6 * steering.offset:+.0f} µs away from its time"
            faults = "; ".join([late, *_deviating(master, settings, label)])
            raise RigFault(f"frames or clocks do not follow the reference clock: {faults}")


def _activate(device: Any, slave: Slave, cycle: float) -> bool:
    """Activates SYNC0 of a slave, and reads back what it took over; returns whether it did."""
    period = round(1e9 * cycle)
    shift = round(1e9 * cycle * slave.sync0_shift)
    sync1 = {"sync1_cycle_time": 0} if slave.assign_activate == SYNC0_AND_SYNC1 else {}
    for _ in range(_ATTEMPTS):
        device.dc_sync(True, period, shift, **sync1)
        start = _register(device, _START, _U64.size)
        registers = _register(device, _ACTIVATION, 1), _register(device, _CYCLE, _U32.size)
        if registers == (slave.assign_activate >> 8, period) and start is not None and start % period == shift:
            return True
    return False


def clock_difference(device: Any) -> float | None:
    """Mean difference of a slave's clock from the reference clock [s], positive if ahead; None without an answer."""
    word = _register(device, _DIFFERENCE, _U32.size)
    if word is None:
        return None
    return 1e-9 * (-_amount(word) if word >> 31 else _amount(word))


def _deviating(master: Any, settings: BusSettings, label: Callable[[int], str]) -> list[str]:
    """Describes the slaves whose clocks differ from the reference clock."""
    words = {
        number: _register(master.slaves[number], _DIFFERENCE, _U32.size)
        for number, slave in enumerate(settings.slaves)
        if slave.assign_activate
    }
    return [
        f"the clock of {label(number)} " + ("does not answer" if word is None else f"differs by {_amount(word)} ns")
        for number, word in words.items()
        if word is None or _amount(word) > SYNCHRONOUS
    ]


def _amount(word: int) -> int:
    """Absolute value of a difference, whose highest bit is its sign."""
    return word & 0x7FFFFFFF


def _register(device: Any, address: int, size: int) -> int | None:
    """Reads a register of a slave controller, or returns None if no reply comes within the bus' present timeout."""
    import pysoem  # here, since a rig without EtherCAT does not need it

    try:
        content = device._fprd(address, size, pysoem.settings.timeouts.ret)  # pysoem has no other name for it
    except pysoem.WkcError:
        return None
    return int.from_bytes(content, "little")

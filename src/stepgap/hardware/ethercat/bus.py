"""The master of an EtherCAT bus: it compares the bus with the settings, brings it to OP and exchanges frames."""

import os
import socket
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from struct import Struct
from time import monotonic, perf_counter, sleep
from typing import Any

from stepgap.hardware.bus_rig import COMPUTER, HostTime
from stepgap.hardware.ethercat.clock_start import clock_difference, start_clocks, synchronise
from stepgap.hardware.ethercat.distributed_clocks import Steering
from stepgap.hardware.ethercat.pdo import Packing, configure_pdos
from stepgap.hardware.ethercat.rig_settings import BusSettings
from stepgap.rigs.rig import MissingObject, RigFault


def claimed(interface: str) -> socket.socket:
    """Claims an interface for this process, until it closes the returned socket or ends in any way.

    The claim is a name of an abstract Unix socket, which belongs to the network namespace, as the interface does.

    Raises:
        RigFault: Another process has claimed it.
    """
    claim = socket.socket(socket.AF_UNIX)
    try:
        claim.bind(f"\0stepgap-master-of-{interface}")
    except OSError:
        claim.close()
        raise RigFault(
            f"another process is already the master of {interface}; end it first, since a bus can have only one master"
        ) from None
    return claim


def open_sockets() -> set[int]:
    """Descriptors of this process that are sockets; pysoem does not report which one it opened."""
    descriptors = set()
    for link in Path("/proc/self/fd").iterdir():
        try:
            if str(link.readlink()).startswith("socket:"):
                descriptors.add(int(link.name))
        except FileNotFoundError:  # the descriptor that lists the folder
            continue
    return descriptors


_ASSIGN_OUTPUTS = 0x1C12  # Object that holds the PDOs of sync manager 2
_ASSIGN_INPUTS = 0x1C13  # The same for sync manager 3
STATE_TIMEOUT = 2.0  # Timeout of a change of the slaves' states [s]
REPLY_TIMEOUT = 100_000  # Timeout of a frame during bring-up [µs]; SOEM's 2,000 are too short when the computer is busy

REQUEST_TIMEOUT = 700_000  # Time in which a mailbox must take a request of an SDO transfer during bring-up [µs]

REQUEST_TIMEOUT_IN_OP = 20_000
"""The same afterwards, as of SOEM; a busy computer can lose all frames of such a time, and the transfer with them."""

SEARCH_TIME = 1.0
"""Time during which missing slaves are searched for [s]; on a busy computer the frame of a search may be late."""

LEAST_WAIT = 50  # Time for which a reply is looked for even if its frame was sent long ago [µs]
MOST_SEARCHES = 3  # Number of searches of which each found enough slaves, but not the expected ones

WATCHDOG_ATTEMPTS = 5  # Number of attempts to set a watchdog, since pysoem waits only 4 ms for its registers

WATCHDOG_PAUSE = 0.1
"""Time between two attempts [s].

More of them, or faster ones, would be a risk: SOEM has 16 frame numbers, so that it takes the late reply to a frame
for the reply to the 16th frame after it.
"""

_NO_OBJECT = 0x06020000  # Abort code of an SDO transfer: there is no such object
_NO_ANSWER = 0  # State of a slave whose answer was lost


class Bus:
    """The slaves of a `BusSettings` behind pysoem.

    Every mismatch between settings and bus raises `RigFault` with one line that names the slave.
    """

    def __init__(self, settings: BusSettings, host: HostTime = COMPUTER):
        self._settings = settings
        self.steering = Steering(settings.cycle, settings.dc, host) if settings.uses_clocks else None
        """Steers the frames to the reference clock; None without distributed clocks."""
        self._master: Any = None
        sets = [settings.pdo_set(slave) for slave in settings.slaves]
        self._outputs = [Packing(pdos.outputs) for pdos in sets]
        self._inputs = [Packing(pdos.inputs) for pdos in sets]
        self._timeout = round(settings.reply_timeout * 1e6)
        self._sent_at = 0.0
        self._sockets: set[int] = set()
        self._claim: socket.socket | None = None
        self._emergencies: list[Any] = []

    def connect(self, prepare: Callable[[], None]) -> None:
        """Brings all slaves to OP, all outputs zero.

        Args:
            prepare: Called while the slaves are in PREOP, where objects can be read and written by SDO.

        Raises:
            RigFault: The interface or pysoem is missing, another process is the master of the bus, or the bus differs
                from the settings.
        """
        self._soem = _pysoem()
        self._limit_waiting(REPLY_TIMEOUT, REQUEST_TIMEOUT)
        self._claim = claimed(self._settings.interface)
        try:
            self._bring_up(self._open(), prepare)
        except (self._soem.SdoError, self._soem.MailboxError, self._soem.PacketError, self._soem.WkcError) as error:
            self.close()
            raise RigFault(f"the bus cannot be brought up: {error!r}") from None
        except BaseException:
            self.close()
            raise

    def _open(self) -> Any:
        master = self._soem.Master()
        master.always_release_gil = True  # an emulated ring may live in this process
        before = open_sockets()
        try:
            master.open(self._settings.interface)
        except ConnectionError:
            raise RigFault(
                f"interface {self._settings.interface} cannot be opened: "
                "it must exist, and raw Ethernet needs root or the capability CAP_NET_RAW"
            ) from None
        self._master = master
        self._sockets = open_sockets() - before
        return master

    def _bring_up(self, master: Any, prepare: Callable[[], None]) -> None:
        self._emergencies.clear()
        self._check_identities(self._search(master))
        for device in master.slaves:
            device.add_emergency_callback(self._emergencies.append)  # without it an emergency makes a transfer fail
        for number, slave in enumerate(self._settings.slaves):
            pdos = self._settings.pdo_set(slave)
            for assignment, wanted in ((_ASSIGN_OUTPUTS, pdos.outputs), (_ASSIGN_INPUTS, pdos.inputs)):
                if wanted:
                    configure_pdos(self, number, assignment, wanted)
            if pdos.outputs:
                self._set_watchdog(number)
        prepare()
        start_clocks(master, self._settings, self.label)
        self._start(master)

    def _search(self, master: Any) -> int:
        """Number of slaves that answer; missing ones are searched for again until `SEARCH_TIME` is over.

        Unexpected ones are, too, but less often, and at least twice: on a busy computer the answer with an identity may
        be lost.
        """
        until = monotonic() + SEARCH_TIME
        wanted = [(slave.vendor, slave.product) for slave in self._settings.slaves]
        strange = 0
        while True:
            count = master.config_init()
            identities = [(device.man, device.id) for device in master.slaves[: max(0, count)]]
            is_strange = count >= len(wanted)
            strange += is_strange
            if identities == wanted or strange == MOST_SEARCHES:
                return count
            if monotonic() > until and not (is_strange and strange == 1):
                return count

    def set_outputs(self, number: int, values: dict[str, int]) -> None:
        """Sets the outputs of a slave for the next frame; more bytes than its own would overwrite the next slave's."""
        data = self._outputs[number].pack(values)
        assert len(data) == self._outputs[number].size
        self._master.slaves[number].output = data

    def send(self) -> None:
        """Sends the frame with all outputs."""
        if self.steering:
            self.steering.sent()
        self._master.send_processdata()
        self._sent_at = perf_counter()

    def receive(self) -> bool:
        """Waits for the frame; returns whether it came back in time and every slave processed it.

        With distributed clocks the time counts from its transmission: a frame that was lost an interval ago must not
        delay the next one, which would miss its window, too.
        """
        waited = round(1e6 * (perf_counter() - self._sent_at)) if self.steering else 0
        remaining = max(self._timeout - waited, LEAST_WAIT)
        good = self._master.receive_processdata(remaining) == self._master.expected_wkc
        if good and self.steering:
            self.steering.returned(self._master.dc_time)
        return good

    def wait(self) -> None:
        """Waits for the time of the next frame, outside of a control loop."""
        if self.steering:
            self.steering.wait()
        else:
            sleep(self._settings.tick)

    def inputs(self, number: int) -> dict[str, int]:
        """Inputs of a slave from the last good frame."""
        return self._inputs[number].unpack(self._master.slaves[number].input)

    def read_object(self, number: int, index: int, layout: Struct, subindex: int = 0) -> int:
        """Reads an object of a slave by SDO; too slow for a tick.

        Raises:
            MissingObject: The slave lacks it.
            RigFault: The slave refuses, or the object has another size.
        """
        data = self._transfer(number, index, subindex, lambda device: device.sdo_read(index, subindex))
        if len(data) != layout.size:
            name = f"object 0x{index:04X}:{subindex:02X}"
            raise RigFault(f"{self.label(number)}: {name} must have {layout.size} bytes, not {len(data)}")
        return layout.unpack(data)[0]

    def write_object(self, number: int, index: int, layout: Struct, value: float, subindex: int = 0) -> None:
        """Writes an object of a slave by SDO; too slow for a tick.

        Raises:
            RigFault: The slave refuses.
        """
        data = layout.pack(value)
        self._transfer(number, index, subindex, lambda device: device.sdo_write(index, subindex, data))

    def in_operation(self) -> bool | None:
        """Whether every slave reports OP, None if not all of them answer; costs one more frame.

        The working counter also counts a slave that has left OP: its memory can still be read, but its inputs no longer
        change.
        """
        state = self._master.read_state()
        return state == self._soem.OP_STATE if state else None

    def clock_difference(self, number: int) -> float | None:
        """Difference of a slave's clock from the reference clock [s], None without an answer; costs one more frame."""
        return clock_difference(self._master.slaves[number])

    def out_of_operation(self) -> list[int]:
        """Numbers of the slaves that report another state than OP; costs frames without process data."""
        self._block(True)
        self._master.read_state()
        return [
            number
            for number, device in enumerate(self._master.slaves)
            if device.state not in (_NO_ANSWER, self._soem.OP_STATE)
        ]

    def state_report(self) -> str:
        """States of the slaves that are not in OP, one line; too slow for a tick."""
        self._block(True)
        return self._states(self._soem.OP_STATE)

    def emergencies(self) -> str:
        """Emergency messages of the slaves received so far; they arrive with SDO transfers, not with frames."""
        return "; ".join(
            f"{self.label(emergency.slave_pos - 1)} sent emergency 0x{emergency.error_code:04X}"
            for emergency in self._emergencies
        )

    def close(self) -> None:
        """Brings all slaves to INIT and releases the interface; may be called twice."""
        master = self._master
        self._master = None
        if master is not None:
            master.state = self._soem.INIT_STATE
            master.write_state()
            master.close()
        if self._claim:
            self._claim.close()

    def revision(self, number: int) -> int | None:
        """Revision number of a slave; None while the bus is not up."""
        return self._master.slaves[number].rev if self._master is not None else None

    def label(self, number: int) -> str:
        """Name of a slave for messages."""
        return f"slave {number + 1} '{self._settings.slaves[number].name}'"

    def _check_identities(self, count: int) -> None:
        wanted = self._settings.slaves
        devices = self._master.slaves[: max(0, count)]
        for number, (slave, device) in enumerate(zip(wanted, devices, strict=False)):
            if (device.man, device.id) != (slave.vendor, slave.product):
                raise RigFault(
                    f"{self.label(number)} must be {_identity(slave.vendor, slave.product)}, "
                    f"but there is {_identity(device.man, device.id)}"
                )
            if slave.revision not in (0, device.rev):
                raise RigFault(
                    f"{self.label(number)} must be revision 0x{slave.revision:08X}, but there is 0x{device.rev:08X}"
                )
        if len(devices) < len(wanted):
            raise RigFault(f"{self.label(len(devices))} is missing: {len(devices)} of {len(wanted)} slaves answer")
        if len(devices) > len(wanted):
            device = devices[len(wanted)]
            raise RigFault(
                f"slave {len(wanted) + 1}, {_identity(device.man, device.id)}, is not in the settings: "
                f"{len(devices)} slaves answer instead of {len(wanted)}"
            )

    def _set_watchdog(self, number: int) -> None:
        for _ in range(WATCHDOG_ATTEMPTS):
            try:
                return self._master.slaves[number].set_watchdog("processdata", self._settings.watchdog * 1e3)
            except self._soem.WkcError:
                sleep(WATCHDOG_PAUSE)
        raise RigFault(f"{self.label(number)}: the watchdog cannot be set")

    def _start(self, master: Any) -> None:
        """Maps the process data and brings the slaves to OP."""
        soem = self._soem
        try:
            master.config_map()
        except soem.ConfigMapError:
            raise RigFault(f"the process data cannot be mapped: {self._states(soem.SAFEOP_STATE)}") from None
        for number, device in enumerate(master.slaves):
            sizes = (len(device.output), len(device.input))
            wanted = (self._outputs[number].size, self._inputs[number].size)
            if sizes != wanted:
                raise RigFault(
                    f"{self.label(number)} must exchange {wanted[0]} bytes out and {wanted[1]} in, "
                    f"but exchanges {sizes[0]} and {sizes[1]}"
                )
            device.output = bytes(wanted[0])
        if master.state_check(soem.SAFEOP_STATE, round(STATE_TIMEOUT * 1e6)) != soem.SAFEOP_STATE:
            raise RigFault(f"a slave refuses SAFEOP: {self._states(soem.SAFEOP_STATE)}")
        if self.steering:
            synchronise(master, self._settings, self.label, self.steering, self._exchange)
        master.state = soem.OP_STATE
        self._exchange()
        master.write_state()
        until = monotonic() + STATE_TIMEOUT
        while not self.in_operation():
            self.wait()
            self._exchange()
            if monotonic() > until:
                raise RigFault(f"a slave refuses OP: {self._states(soem.OP_STATE)}")
        self._limit_waiting(self._timeout, REQUEST_TIMEOUT_IN_OP)
        self._block(False)  # otherwise a lost frame delays the tick by a tick of the kernel

    def _exchange(self) -> None:
        self.send()
        self.receive()

    def _states(self, wanted: int) -> str:
        """The slaves that are not in the wanted state, and the reasons."""
        self._master.read_state()
        states = [
            f"{self.label(number)} {self._al_state(device)}"
            for number, device in enumerate(self._master.slaves)
            if device.state != wanted
        ]
        return "; ".join(states) or "every slave is in the right state now"

    def _al_state(self, device: Any) -> str:
        """Describes state and status code of a slave."""
        names = {0: "does not answer", 1: "is in INIT", 2: "is in PREOP", 4: "is in SAFEOP", 8: "is in OP"}
        reason = f" (0x{device.al_status:04X}: {self._soem.al_status_code_to_string(device.al_status)})"
        return names.get(device.state & 0x0F, "is in an unknown state") + (reason if device.al_status else "")

    def _transfer(self, number: int, index: int, subindex: int, transfer: Any) -> Any:
        soem = self._soem
        try:
            return transfer(self._master.slaves[number])
        except soem.SdoError as error:
            reason = f"0x{error.abort_code:08X} {error.desc}"
            kind = MissingObject if error.abort_code == _NO_OBJECT else RigFault
        except (soem.MailboxError, soem.PacketError, soem.WkcError) as error:
            reason = f"no answer ({type(error).__name__})"
            kind = RigFault
        except AssertionError:  # pysoem asserts that the error in SOEM's list is of this slave
            reason = "no answer, after an error of another slave"
            kind = RigFault
        raise kind(f"{self.label(number)}: object 0x{index:04X}:{subindex:02X} is refused: {reason}")

    def _limit_waiting(self, reply: int, request: int) -> None:
        timeouts = self._soem.settings.timeouts
        timeouts.ret = reply
        timeouts.tx_mailbox = request

    def _block(self, blocking: bool) -> None:
        """Whether reading the sockets waits in the kernel."""
        for descriptor in self._sockets:
            os.set_blocking(descriptor, blocking)


def _pysoem() -> Any:
    try:
        return import_module("pysoem")
    except ModuleNotFoundError:
        raise RigFault("an EtherCAT rig needs pysoem: pip install 'stepgap[ethercat]'") from None


def _identity(vendor: int, product: int) -> str:
    return f"vendor 0x{vendor:08X} product 0x{product:08X}"

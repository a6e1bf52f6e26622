"""The bus seen from the master: brought up only if it is what the settings say, then one frame a tick."""

import os
import socket
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from struct import Struct
from time import monotonic
from typing import Any

from stepgap.rigs.ethercat.pdo import Packing, Pdo
from stepgap.rigs.ethercat.rig_settings import BusSettings
from stepgap.rigs.rig import RigFault

_ASSIGN_OUTPUTS, _ASSIGN_INPUTS = 0x1C12, 0x1C13
"""Objects that hold the PDOs of sync managers 2 and 3."""

STATE_TIMEOUT = 2.0
"""How long slaves may take to change state [s]."""

REPLY_TIMEOUT = 20_000
"""How long a frame is waited for while the bus is brought up [µs]; SOEM's 2,000 are short where a kernel is busy."""

WATCHDOG_ATTEMPTS = 5

_U8, _U16, _U32 = Struct("<B"), Struct("<H"), Struct("<I")


class Bus:
    """The slaves of a `BusSettings` behind pysoem.

    Every mismatch between settings and bus raises `RigFault` with one line that names the slave.

    Args:
        settings: What should be there.
    """

    def __init__(self, settings: BusSettings):
        self._settings = settings
        self._master: Any = None
        sets = [settings.pdo_set(slave) for slave in settings.slaves]
        self._outputs = [Packing(pdos.outputs) for pdos in sets]
        self._inputs = [Packing(pdos.inputs) for pdos in sets]
        self._timeout = round(settings.reply_timeout * 1e6)
        self._sockets: set[int] = set()
        self._claim: socket.socket | None = None
        self._emergencies: list[Any] = []

    def connect(self, prepare: Callable[[], None]) -> None:
        """Brings all slaves to OP, all outputs zero.

        Args:
            prepare: Called while the slaves are in PREOP and may be asked and told by SDO without haste.

        Raises:
            RigFault: There is no such interface or no pysoem, another master has the bus, or it is not as the settings
                say.
        """
        self._soem = _pysoem()
        self._soem.settings.timeouts.ret = REPLY_TIMEOUT
        self._claim = _claimed(self._settings.interface)
        try:
            self._bring_up(self._open(), prepare)
        except (self._soem.SdoError, self._soem.MailboxError, self._soem.PacketError, self._soem.WkcError) as error:
            self.close()
            raise RigFault(f"the bus cannot be brought up: {error!r}") from None
        except BaseException:
            self.close()
            raise

    def _open(self) -> Any:
        """The master on its interface."""
        master = self._soem.Master()
        master.always_release_gil = True  # an emulated ring may live in this process
        before = _sockets()
        try:
            master.open(self._settings.interface)
        except ConnectionError:
            raise RigFault(
                f"interface {self._settings.interface} cannot be opened: "
                "it must exist, and raw Ethernet needs root or the capability CAP_NET_RAW"
            ) from None
        self._master, self._sockets = master, _sockets() - before
        return master

    def _bring_up(self, master: Any, prepare: Callable[[], None]) -> None:
        self._emergencies.clear()
        self._check_identities(master.config_init())
        for device in master.slaves:
            device.add_emergency_callback(self._emergencies.append)  # without, a transfer that meets one fails
        for number in range(len(self._settings.slaves)):
            self._configure(number)
        prepare()
        self._start(master)

    def set_outputs(self, number: int, values: dict[str, int]) -> None:
        """Values for a slave, sent with the next frame; exactly its bytes, for more would reach the next slave's."""
        data = self._outputs[number].pack(values)
        assert len(data) == self._outputs[number].size
        self._master.slaves[number].output = data

    def send(self) -> None:
        """Sends the frame with all outputs."""
        self._master.send_processdata()

    def receive(self) -> bool:
        """Waits for the frame; whether it came back in time and every slave took part."""
        return self._master.receive_processdata(self._timeout) == self._master.expected_wkc

    def inputs(self, number: int) -> dict[str, int]:
        """Values of a slave as the last good frame brought them."""
        return self._inputs[number].unpack(self._master.slaves[number].input)

    def read_object(self, number: int, index: int, layout: Struct) -> int:
        """An object of a slave by SDO, not for the time of a tick.

        Raises:
            RigFault: The slave refuses.
        """
        return self._read(number, index, 0, layout)

    def write_object(self, number: int, index: int, layout: Struct, value: int) -> None:
        """Sets an object of a slave by SDO, not for the time of a tick.

        Raises:
            RigFault: The slave refuses.
        """
        self._write(number, index, 0, layout, value)

    def in_operation(self) -> bool | None:
        """Whether every slave says that it is in OP, None where not all of them answer; one frame more.

        A slave may leave OP and yet be counted, its inputs frozen, since its memory is still there.
        """
        state = self._master.read_state()
        return state == self._soem.OP_STATE if state else None

    def complaint(self) -> str:
        """What slaves say that are not in OP, one line; not for the time of a tick."""
        self._block(True)
        return self._states(self._soem.OP_STATE)

    def emergencies(self) -> str:
        """Emergencies that slaves sent, as far as they have come in: they arrive with transfers, not with frames."""
        return "; ".join(
            f"{self.label(emergency.slave_pos - 1)} sent emergency 0x{emergency.error_code:04X}"
            for emergency in self._emergencies
        )

    def close(self) -> None:
        """All slaves to INIT, the interface released; may be called twice."""
        master, self._master = self._master, None
        if master is not None:
            master.state = self._soem.INIT_STATE
            master.write_state()
            master.close()
        if self._claim:
            self._claim.close()

    def label(self, number: int) -> str:
        """A slave as messages name it."""
        return f"slave {number + 1} '{self._settings.slaves[number].name}'"

    def _check_identities(self, count: int) -> None:
        wanted, found = self._settings.slaves, self._master.slaves[: max(0, count)]
        for number, (slave, device) in enumerate(zip(wanted, found, strict=False)):
            if (device.man, device.id) != (slave.vendor, slave.product):
                raise RigFault(
                    f"{self.label(number)} must be {_identity(slave.vendor, slave.product)}, "
                    f"but there is {_identity(device.man, device.id)}"
                )
        if len(found) < len(wanted):
            raise RigFault(f"{self.label(len(found))} is missing: {len(found)} of {len(wanted)} slaves answer")
        if len(found) > len(wanted):
            device = found[len(wanted)]
            raise RigFault(
                f"slave {len(wanted) + 1}, {_identity(device.man, device.id)}, is not in the settings: "
                f"{len(found)} slaves answer instead of {len(wanted)}"
            )

    def _configure(self, number: int) -> None:
        """PDOs and watchdog of one slave, in PREOP."""
        pdos = self._settings.pdo_set(self._settings.slaves[number])
        for assignment, wanted, packing in (
            (_ASSIGN_OUTPUTS, pdos.outputs, self._outputs[number]),
            (_ASSIGN_INPUTS, pdos.inputs, self._inputs[number]),
        ):
            if wanted:
                self._assign(number, assignment, wanted)
                self._check_mapping(number, wanted, packing)
        if pdos.outputs:
            self._set_watchdog(number)

    def _set_watchdog(self, number: int) -> None:
        """Registers, not objects: pysoem waits 2 ms for each, so a reply may be missed where a kernel is busy."""
        for _ in range(WATCHDOG_ATTEMPTS):
            try:
                return self._master.slaves[number].set_watchdog("processdata", self._settings.watchdog * 1e3)
            except self._soem.WkcError:
                continue
        raise RigFault(f"{self.label(number)}: the watchdog cannot be set")

    def _assign(self, number: int, assignment: int, pdos: tuple[Pdo, ...]) -> None:
        """Assigns PDOs, unless they are; some terminals know but one set and refuse to be told."""
        present = [
            self._read(number, assignment, place, _U16)
            for place in range(1, self._read(number, assignment, 0, _U8) + 1)
        ]
        if present == [pdo.index for pdo in pdos]:
            return
        self._write(number, assignment, 0, _U8, 0)
        for place, pdo in enumerate(pdos, start=1):
            self._write(number, assignment, place, _U16, pdo.index)
        self._write(number, assignment, 0, _U8, len(pdos))

    def _check_mapping(self, number: int, pdos: tuple[Pdo, ...], packing: Packing) -> None:
        """Holds what the slave maps against the settings: each value used at its place, and the length."""
        found, bit = {}, 0
        for pdo in pdos:
            for place in range(1, self._read(number, pdo.index, 0, _U8) + 1):
                word = self._read(number, pdo.index, place, _U32)
                bits = word & 0xFF
                found[bit] = (word >> 16, word >> 8 & 0xFF, bits)
                bit += bits
        for entry, at in packing.places.values():
            if found.get(at) != (entry.index, entry.subindex, entry.bits):
                there = "0x{:04X}:{:02X}:{}".format(*found[at]) if at in found else "none"
                raise RigFault(f"{self.label(number)} must map {entry} at byte {at // 8}, but there is {there}")
        if bit != 8 * packing.size:
            indices = ", ".join(f"0x{pdo.index:04X}" for pdo in pdos)
            raise RigFault(f"{self.label(number)} must map {packing.size} bytes in {indices}, but maps {bit / 8:g}")

    def _start(self, master: Any) -> None:
        """Maps the process data and goes to OP."""
        soem = self._soem
        try:
            master.config_map()
        except soem.ConfigMapError:
            raise RigFault(f"the process data cannot be mapped: {self._states(soem.SAFEOP_STATE)}") from None
        for number, device in enumerate(master.slaves):
            found, wanted = (
                (len(device.output), len(device.input)),
                (self._outputs[number].size, self._inputs[number].size),
            )
            if found != wanted:
                raise RigFault(
                    f"{self.label(number)} must exchange {wanted[0]} bytes out and {wanted[1]} in, "
                    f"but exchanges {found[0]} and {found[1]}"
                )
            device.output = bytes(wanted[0])
        if master.state_check(soem.SAFEOP_STATE, round(STATE_TIMEOUT * 1e6)) != soem.SAFEOP_STATE:
            raise RigFault(f"a slave refuses SAFEOP: {self._states(soem.SAFEOP_STATE)}")
        master.state = soem.OP_STATE
        self._exchange()
        master.write_state()
        until = monotonic() + STATE_TIMEOUT
        while master.state_check(soem.OP_STATE, 1000) != soem.OP_STATE:
            self._exchange()
            if monotonic() > until:
                raise RigFault(f"a slave refuses OP: {self._states(soem.OP_STATE)}")
        soem.settings.timeouts.ret = self._timeout
        self._block(False)  # else a lost frame holds up the tick for a whole tick of the kernel

    def _exchange(self) -> None:
        self.send()
        self.receive()

    def _states(self, wanted: int) -> str:
        """The slaves that are not in a state, and why."""
        self._master.read_state()
        found = [
            f"{self.label(number)} {self._al_state(device)}"
            for number, device in enumerate(self._master.slaves)
            if device.state != wanted
        ]
        return "; ".join(found) or "every slave is in the right state now"

    def _al_state(self, device: Any) -> str:
        """State and status code of a slave in words."""
        names = {0: "does not answer", 1: "is in INIT", 2: "is in PREOP", 4: "is in SAFEOP", 8: "is in OP"}
        reason = f" (0x{device.al_status:04X}: {self._soem.al_status_code_to_string(device.al_status)})"
        return names.get(device.state & 0x0F, "is in no known state") + (reason if device.al_status else "")

    def _read(self, number: int, index: int, subindex: int, layout: Struct) -> int:
        data = self._transfer(number, index, subindex, lambda device: device.sdo_read(index, subindex))
        if len(data) != layout.size:
            name = f"object 0x{index:04X}:{subindex:02X}"
            raise RigFault(f"{self.label(number)}: {name} must have {layout.size} bytes, not {len(data)}")
        return layout.unpack(data)[0]

    def _write(self, number: int, index: int, subindex: int, layout: Struct, value: int) -> None:
        data = layout.pack(value)
        self._transfer(number, index, subindex, lambda device: device.sdo_write(index, subindex, data))

    def _transfer(self, number: int, index: int, subindex: int, transfer: Any) -> Any:
        soem = self._soem
        try:
            return transfer(self._master.slaves[number])
        except soem.SdoError as error:
            reason = f"0x{error.abort_code:08X} {error.desc}"
        except (soem.MailboxError, soem.PacketError, soem.WkcError) as error:
            reason = f"no answer ({type(error).__name__})"
        raise RigFault(f"{self.label(number)}: object 0x{index:04X}:{subindex:02X} is refused: {reason}")

    def _block(self, blocking: bool) -> None:
        """Whether reading the sockets waits in the kernel."""
        for descriptor in self._sockets:
            os.set_blocking(descriptor, blocking)


def _pysoem() -> Any:
    try:
        return import_module("pysoem")
    except ModuleNotFoundError:
        raise RigFault("an EtherCAT rig needs pysoem: pip install 'stepgap[ethercat]'") from None


def _claimed(interface: str) -> socket.socket:
    """What only one process at a time can have for an interface, until it closes it or ends, in whatever way.

    A name of Linux's abstract sockets: it belongs to the network namespace, as the interface does.
    """
    claim = socket.socket(socket.AF_UNIX)
    try:
        claim.bind(f"\0stepgap-master-of-{interface}")
    except OSError:
        claim.close()
        raise RigFault(
            f"another process is the master of {interface} already; two would fight over the drives"
        ) from None
    return claim


def _identity(vendor: int, product: int) -> str:
    return f"vendor 0x{vendor:08X} product 0x{product:08X}"


def _sockets() -> set[int]:
    """Descriptors of this process that are sockets; pysoem does not say which one it opened."""
    found = set()
    for link in Path("/proc/self/fd").iterdir():
        try:
            if str(link.readlink()).startswith("socket:"):
                found.add(int(link.name))
        except FileNotFoundError:  # the one that lists the folder
            continue
    return found

"""A robot on an EtherCAT bus as a `Rig`: drives in cyclic synchronous torque, encoders, force sensors."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from itertools import cycle
from math import nan
from pathlib import Path
from struct import Struct
from time import monotonic, sleep

from stepgap.hardware.bus_rig import COMPUTER, BusRig, HostTime
from stepgap.hardware.ethercat.bus import STATE_TIMEOUT, Bus
from stepgap.hardware.ethercat.cia402 import (
    CYCLIC_TORQUE,
    DISABLE_VOLTAGE,
    ENABLE,
    State,
    Wanted,
    next_controlword,
    state_of,
)
from stepgap.hardware.ethercat.drive_setup import check_modes, prepare_slaves
from stepgap.hardware.ethercat.drive_watch import WatchedDrives
from stepgap.hardware.ethercat.esi.comparison import compare_with_esi
from stepgap.hardware.ethercat.esi.reader import read_esi
from stepgap.hardware.ethercat.rig_settings import BusSettings, Encoder
from stepgap.hardware.ethercat.sensor_channels import EncoderChannel, ForceChannel
from stepgap.rigs.rig import (
    CLOCK_DIFFERENCE,
    CLOCK_OFFSET,
    CLOCK_OUTSIDE,
    ClockLimits,
    DoubtfulSensor,
    Finding,
    Reading,
    RigFault,
    SensorModel,
    Torques,
    WatchdogTimes,
)

_ERROR_CODE = 0x603F
_STATUSWORD = 0x6041
_U16 = Struct("<H")

CLOCK_DIAGNOSTICS = {CLOCK_OFFSET: "s", "clock_correction": "s", CLOCK_OUTSIDE: "frames"}
"""Values of the synchronisation with the reference clock that are logged, with their units."""

STATES_EVERY = 50
"""Number of good frames between two checks of the slaves' states, and between two readings of a slave's clock."""


WATCHDOG_PATIENCE = 0.1  # Time in addition to twice the watchdog's until it counts as missing [s]
OPEN_FRAMES = 20  # Number of frames in a row with an open STO or enable input, after which drives are not enabled
_LAST_FRAMES = 3  # Number of frames without torque that are sent at the end, in case one is lost


class EthercatRig(BusRig):
    """Drives and encoders as `rig.toml` describes them.

    Every `write` sends a frame, and the next `read` receives it. If a frame is lost, or a slave did not process it, the
    reading before is repeated; too many such frames in a row are a fault. Any fault disables the voltage of all drives.
    A drive that is in fault at connect is reset once, since connecting is a deliberate act.

    Args:
        settings: The robot's bus, with its limit of lost frames.
        host: The computer's clock, by which frames follow the reference clock of the bus.
        folder: Folder to which the names of ESI files are relative.
    """

    def __init__(
        self, settings: BusSettings, sensor_model: SensorModel, host: HostTime = COMPUTER, folder: Path = Path()
    ):
        super().__init__(settings, sensor_model)
        self._settings = settings
        self._bus = Bus(settings, host)
        self._folder = folder
        self._motors = settings.motors
        self._drives = tuple(settings.position(motor.slave) for motor in self._motors)
        self._sensors = tuple(
            EncoderChannel(settings, device) if isinstance(device, Encoder) else ForceChannel(settings, device)
            for device in settings.devices.values()
        )
        self._watched = WatchedDrives(settings, self._bus.label, self._bus.inputs)
        synchronised = [number for number, slave in enumerate(settings.slaves) if slave.assign_activate]
        self._differences = dict.fromkeys(synchronised, nan)
        self._next_clock = cycle(synchronised)
        self._connected = False
        self._remarks = list[str]()
        self._frame_pending = False
        self._good_frames = 0
        self._unanswered = 0
        self._reading = settings.reading((0.0,) * len(self._sensors))

    @property
    def diagnostic_units(self) -> Mapping[str, str]:
        """Status word of every drive, its velocity and torque in its own units, and what `DriveLimits` limit.

        Each only if the drive sends it. With distributed clocks also how much too late a frame passed the reference
        clock, the last correction, and how far the clocks of the slaves with SYNC0, numbered from 1, are ahead of it.
        """
        if not self._bus.steering:
            return self._watched.units
        differences = {f"slave_{number + 1}_{CLOCK_DIFFERENCE}": "s" for number in self._differences}
        return {**self._watched.units, **CLOCK_DIAGNOSTICS, **differences}

    @property
    def diagnostic_ranges(self) -> Mapping[str, tuple[float, float]]:
        """Limits of temperatures and bus voltages; infinite where there is none."""
        return self._watched.ranges

    @property
    def diagnostic_names(self) -> Mapping[str, Mapping[int, str]]:
        """Names of the states of STO and enable inputs."""
        return self._watched.names

    @property
    def diagnostics(self) -> tuple[float, ...]:
        """Those values in the last good frame."""
        steering = self._bus.steering
        values = self._watched.values
        if not steering:
            return values
        return (*values, steering.farthest, steering.shift, steering.outside, *self._differences.values())

    @property
    def clock_limits(self) -> ClockLimits | None:
        """Limits of frames and clocks in a check; None without distributed clocks."""
        return self._settings.dc.limits(self._settings.cycle) if self._bus.steering else None

    def clock_correction(self, slip: float = 0.0) -> float:
        """Time by which the ticks shall be later, so that frames follow the reference clock [s]; 0 without clocks."""
        steering = self._bus.steering
        return steering.correction(slip, self._settings.frames_per_tick) if steering else 0.0

    @property
    def warning(self) -> str:
        """Temperature above its warning level, or temperature or bus voltage that cannot be relied upon."""
        return self._watched.warning

    @property
    def remarks(self) -> tuple[str, ...]:
        """Objects of the drives that could not be set, and what they report without a limit."""
        return (*self._remarks, *self._watched.remarks)

    def findings(self) -> tuple[Finding, ...]:
        """What the ESI files of the slaves say against the settings; while connected also about their revisions.

        Raises:
            InputError: A file cannot be read, or is not an ESI file.
        """
        slaves = self._settings.slaves
        files = {name: read_esi(self._folder / name) for name in sorted({slave.esi for slave in slaves} - {""})}
        findings = list[Finding]()
        for number, slave in enumerate(slaves):
            if slave.esi:
                label = f"{self._bus.label(number)}, {slave.esi}"
                pdos = self._settings.pdo_set(slave)
                said = compare_with_esi(slave, pdos, files[slave.esi], STATE_TIMEOUT, self._bus.revision(number))
                findings += [replace(finding, text=f"{label}: {finding.text}") for finding in said]
        return tuple(findings)

    def connect(self) -> None:
        """Brings the bus up, checks it, and enables the drives with no torque.

        Raises:
            RigFault: The bus differs from the settings, a drive cannot be enabled, or the rig had a fault before.
        """
        self._require_no_fault()
        self.close()
        self._bus.connect(self._prepare)
        self._connected = True
        try:
            self._transition(Wanted.RESET, lambda states: State.FAULT not in states)
            self._transition(Wanted.ENABLED, lambda states: set(states) == {State.ENABLED})
            check_modes(self._bus, self._settings)
            self._watched.restart()
            self._update_reading()
        except BaseException:
            self.close()
            raise
        self._losses.restart()
        self._frame_pending = False
        self._good_frames = 0
        self._unanswered = 0
        if self._bus.steering:
            self._bus.steering.restart()

    def read(self) -> Reading:
        """Reads counts and force of the last frame, or of an earlier one if no more frames than allowed are lost.

        Raises:
            RigFault: Not connected, too many frames lost, or a drive no longer accepts torque commands.
        """
        self._check_up()
        if not self._frame_pending:
            return self._reading
        self._frame_pending = False
        if self._bus.receive():
            self._losses.received()
            self._update_reading()
            self._good_frames += 1
            if self._bus.steering and (late := self._bus.steering.fault):
                raise self._trip(late)
        elif missed := self._losses.missed():
            fault = self._trip(f"the frames of {missed} were lost or not processed by every slave")
            raise RigFault(f"{fault}: {self._bus.state_report()}")
        return self._reading

    def write(self, torques: Torques) -> Torques:
        """Sends the motor torques [N·m] and returns those sent: rounded to 1/1000 of the rated torque, within limits.

        Raises:
            RigFault: A torque is not finite, the rig is stopped, or a slave has left OP.
        """
        self._check_up()
        if self._frame_pending:
            self.read()
        self._require_finite(torques)
        sent = []
        for drive, motor, torque in zip(self._drives, self._motors, torques, strict=True):
            unit = motor.torque_unit
            most = motor.most_units
            units = round(min(max(torque / unit, -most), most))
            self._command(drive, motor.sign * units, ENABLE)
            self._watched.command(drive, motor.sign * units)
            sent.append(units * unit)
        self._bus.send()
        self._frame_pending = True
        self._check_al_states()  # after the frame, which it would delay otherwise
        self._read_clock()
        return tuple(sent)

    def watchdog_times(self) -> WatchdogTimes:
        """Sends a last frame, without torque, and measures when the drives leave OP and the state *operation enabled*.

        Raises:
            RigFault: A drive still accepts torque after twice the time of its watchdog.
        """
        self.write((0.0,) * len(self._drives))
        last = monotonic()
        measured = {}
        self._bus.receive()
        watched = {drive: self._settings.slaves[drive].name for drive in self._drives}
        while monotonic() < last + 2 * self._settings.watchdog + WATCHDOG_PATIENCE:
            for drive in watched.keys() & self._bus.out_of_operation():
                if state_of(self._bus.read_object(drive, _STATUSWORD, _U16)) != State.ENABLED:
                    measured[watched.pop(drive)] = monotonic() - last
            if not watched:
                return WatchdogTimes(self._settings.watchdog, measured)
            sleep(self._settings.tick)
        raise RigFault(
            f"{self._bus.label(min(watched))} accepts torque {monotonic() - last:.2f} s after the last frame: "
            f"its watchdog of {self._settings.watchdog:g} s does not work"
        )

    def close(self) -> None:
        """Switches torque and drives off and brings the slaves to INIT; may be called twice."""
        if self._connected:
            self._connected = False
            self._torque_off()
        self._bus.close()

    def _prepare(self) -> None:
        self._remarks = prepare_slaves(self._bus, self._settings)

    def _transition(self, wanted: Wanted, arrived: Callable[[tuple[State, ...]], bool]) -> None:
        """Exchanges frames without torque until the drives have arrived at the wanted state."""
        until = monotonic() + STATE_TIMEOUT
        controlwords = [DISABLE_VOLTAGE] * len(self._drives)
        frames_open = 0
        while True:
            for drive, controlword in zip(self._drives, controlwords, strict=True):
                self._command(drive, 0, controlword)
            self._bus.send()
            if self._bus.receive():
                status = [self._bus.inputs(drive)["statusword"] for drive in self._drives]
                states, controlwords = zip(*(next_controlword(word, wanted) for word in status), strict=True)
                opened = self._watched.open_inputs()
                if arrived(states) and not opened:
                    return
                frames_open = frames_open + 1 if opened else 0
                if frames_open > OPEN_FRAMES:
                    raise RigFault(f"{opened}, so that the drives get no torque: {self._drive_report()}")
                if monotonic() > until:
                    hint = f"; {self._watched.hint}" if self._watched.hint else ""
                    raise RigFault(f"the drives cannot be {wanted.name.lower()}: {self._drive_report()}{hint}")
            elif monotonic() > until:
                raise RigFault(f"no frame comes back: {self._bus.state_report()}")
            self._bus.wait()

    def _update_reading(self) -> None:
        """Updates the reading from a good frame; a drive that takes no torque or a doubtful sensor is a fault."""
        if excess := self._watched.update():
            raise self._trip(excess)
        for drive in self._drives:
            values = self._bus.inputs(drive)
            mode = values.get("mode_display", CYCLIC_TORQUE)
            if state_of(values["statusword"]) != State.ENABLED or mode != CYCLIC_TORQUE:
                fault = self._trip(f"{self._bus.label(drive)} no longer accepts torque commands")
                opened = self._watched.open_inputs()  # some drives report it later than their state
                raise RigFault("; ".join(filter(None, [opened, f"{fault}: {self._drive_report()}"])))
        self._reading = self._settings.reading([sensor.value(self._bus) for sensor in self._sensors])
        for sensor in self._sensors:
            if doubt := sensor.doubt:
                raise DoubtfulSensor(str(self._trip(f"{self._bus.label(sensor.slave)}: {doubt.value}")))

    def _check_al_states(self) -> None:
        """Checks every `STATES_EVERY` frames whether all slaves are in OP; repeats the request if a reply is lost."""
        is_due = self._unanswered or self._good_frames % STATES_EVERY == 0
        if self._losses.in_a_row or not is_due:
            return
        in_operation = self._bus.in_operation()
        self._unanswered = self._unanswered + 1 if in_operation is None else 0
        if in_operation is False:
            fault = self._trip("a slave has left OP")
        elif self._unanswered > self._budgets.lost_frames:
            fault = self._trip(f"slaves did not report their states to {self._unanswered} requests in a row")
        else:
            return
        raise RigFault(f"{fault}: {self._bus.state_report()}")

    def _read_clock(self) -> None:
        """Reads how far the clock of one slave is ahead, each in turn, between two checks of the states."""
        if self._differences and not self._losses.in_a_row and self._good_frames % STATES_EVERY == STATES_EVERY // 2:
            number = next(self._next_clock)
            difference = self._bus.clock_difference(number)
            self._differences[number] = self._differences[number] if difference is None else difference

    def _command(self, drive: int, units: int, controlword: int) -> None:
        self._bus.set_outputs(drive, {"target_torque": units, "controlword": controlword, "mode": CYCLIC_TORQUE})

    def _check_up(self) -> None:
        if self._fault or not self._connected:
            raise RigFault(self._fault or "the rig is not connected")

    def _torque_off(self) -> None:
        """Disables the voltage of all drives."""
        for _ in range(_LAST_FRAMES):
            for drive in self._drives:
                self._command(drive, 0, DISABLE_VOLTAGE)
            self._bus.send()
            self._bus.receive()

    def _drive_report(self) -> str:
        """Reports state, mode and error of all drives, and slaves that have left OP; too slow for a tick."""
        reports = [self._report_of(drive) for drive in self._drives]
        left = self._bus.state_report() if self._bus.out_of_operation() else ""
        return "; ".join(filter(None, [*reports, self._bus.emergencies(), left]))

    def _report_of(self, drive: int) -> str:
        values = self._bus.inputs(drive)
        state = state_of(values["statusword"]).value
        mode = f", mode {values['mode_display']}" if "mode_display" in values else ""
        watched = self._watched.describe(drive)
        text = f"{self._bus.label(drive)} is in state {state}{mode}{', ' if watched else ''}{watched}"
        try:
            error = self._bus.read_object(drive, _ERROR_CODE, _U16)
        except RigFault:  # for example a drive without power; this must not hide the first fault
            return f"{text}, its error is unknown"
        return f"{text}, error 0x{error:04X}" if error else text

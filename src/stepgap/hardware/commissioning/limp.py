"""A real-time process that reads a robot's bus and gives it no torque."""

# pyright: reportIncompatibleMethodOverride=false
# (Properties that `_of_rig` makes are no functions to it.)

from collections.abc import Callable, Iterable, Mapping
from ctypes import c_longlong
from dataclasses import dataclass, field
from functools import partial
from math import isfinite
from multiprocessing import RawValue
from time import sleep
from typing import Any

import numpy as np

from stepgap.base.signals import terminated_as_interrupted
from stepgap.hardware.realtime.process import RealtimeSetup
from stepgap.hardware.realtime.session import Session, TickSink
from stepgap.plants.tick_control import RobotControl
from stepgap.plants.ticks.rig_state import RigState
from stepgap.plants.ticks.tick_table import TickTable
from stepgap.rigs.limits import RigLimits
from stepgap.rigs.rig import Finding, Reading, Rig, RigFault, Torques
from stepgap.step import Array


@dataclass(frozen=True)
class FrameCount:
    """Counts lost frames in the process of the rig, for the process that started it."""

    memory: Any = field(default_factory=lambda: RawValue(c_longlong, 0))

    @property
    def lost(self) -> int:
        """Number of lost frames so far."""
        return self.memory.value

    def count(self) -> None:
        """Counts one more lost frame."""
        self.memory.value += 1


def _of_rig(name: str) -> property:
    return property(lambda limp: getattr(limp._rig, name))


class LimpRig(Rig):
    """Reads a rig and always writes zero torque.

    Args:
        rig: The rig to read.
        limits: Limits that stop it: those of lost frames, but neither those of pose nor of speed.
        frames: Counts the lost frames.
    """

    def __init__(self, rig: Rig, limits: RigLimits, frames: FrameCount):
        self._rig = rig
        self._limits = limits
        self._frames = frames

    @property
    def limits(self) -> RigLimits:
        """Limits as given."""
        return self._limits

    # all else is that of the rig; after its warning a limp robot is switched off
    sensor_model = _of_rig("sensor_model")
    health = _of_rig("health")
    diagnostic_units = _of_rig("diagnostic_units")
    diagnostics = _of_rig("diagnostics")
    diagnostic_ranges = _of_rig("diagnostic_ranges")
    diagnostic_names = _of_rig("diagnostic_names")
    warning = _of_rig("warning")
    clock_limits = _of_rig("clock_limits")
    remarks = _of_rig("remarks")

    def findings(self) -> tuple[Finding, ...]:
        """Those of the rig."""
        return self._rig.findings()

    def clock_correction(self, slip: float = 0.0) -> float:
        """That of the rig."""
        return self._rig.clock_correction(slip)

    def connect(self) -> None:
        """Connects the rig."""
        self._rig.connect()

    def read(self) -> Reading:
        """Reads the rig and counts a lost frame."""
        try:
            return self._rig.read()
        finally:
            if self._rig.health.frame_lost:
                self._frames.count()

    def write(self, torques: Torques) -> Torques:
        """Writes zero torque instead of the given torques."""
        return self._rig.write((0.0,) * len(torques))

    def close(self) -> None:
        """Closes the rig."""
        self._rig.close()


_CHECK_EVERY = 0.05  # Time between two checks whether there are enough ticks [s]


@dataclass(frozen=True)
class LimpTicks:
    """Ticks of a rig without torque, from the first one on.

    Attributes:
        table: The ticks, at least one.
        refused: The requests that the kernel refused; empty if there were none.
        fault: Why there are fewer ticks than requested; empty if there are not.
    """

    table: TickTable
    refused: str
    fault: str


def ticks_of(setup: RealtimeSetup, count: int) -> LimpTicks:
    """Runs a rig for a number of ticks, without a request to step.

    Raises:
        RigFault: There was no tick at all.
    """
    kept = _Memory()
    refused = ""
    session = Session(setup, kept)
    try:
        with terminated_as_interrupted():
            while kept.count < count and not session.over():
                sleep(_CHECK_EVERY)
                if session.board.state in (RigState.CALIBRATE, RigState.READY):
                    refused = refused or session.message()
        fault = ended(session)
    finally:
        session.close()
    if not kept.count:
        raise RigFault(fault)
    return LimpTicks(TickTable(setup.units, np.concatenate(kept.blocks)[:count]), refused, fault)


def ended(session: Session) -> str:
    """Reason why a session has ended; empty while it is running."""
    return (session.message() or "the real-time process ended") if session.over() else ""


class _Memory(TickSink):
    """Keeps ticks in memory."""

    def __init__(self) -> None:
        self.blocks: list[Array] = []
        self.count = 0

    def append(self, rows: Array) -> None:
        self.blocks.append(rows)
        self.count += len(rows)


class LastTick(TickSink):
    """Keeps the last tick with known sensor values, and what is known of later ones, such as that of a fault.

    Attributes:
        fields: Last known values by name; empty before the first tick with all of them.
    """

    def __init__(self, names: Iterable[str]):
        self._names = tuple(names)
        self.fields: dict[str, float] = {}

    def append(self, rows: Array) -> None:
        """Takes ticks."""
        later = list[list[float]]()
        for row in rows[::-1].tolist():
            if all(map(isfinite, row)):
                self.fields = dict(zip(self._names, row, strict=True))
                break
            later.append(row)
        if self.fields:
            for row in reversed(later):
                self.fields |= {name: value for name, value in zip(self._names, row, strict=True) if isfinite(value)}


def describe_devices(rig: Rig, fields: Mapping[str, float]) -> dict[str, str]:
    """Describes what the rig itself judges: temperatures, bus voltages and the state of inputs of its drives.

    Args:
        rig: The rig.
        fields: Fields of a tick by name.
    """
    names = rig.diagnostic_names
    units = rig.diagnostic_units
    judged = {name: fields[name] for name in units if name in fields and name in {*names, *rig.diagnostic_ranges}}
    return {
        name: names[name].get(round(value), f"{value:g}") if name in names else f"{value:.1f} {units[name]}"
        for name, value in judged.items()
        if isfinite(value)
    }


def limp_setup(make_rig: Callable[[], Rig], robot_control: RobotControl, frames: FrameCount) -> RealtimeSetup:
    """Creates the setup of a robot that gets no torque.

    Args:
        make_rig: Creates its rig; it must be possible to pickle it.
        robot_control: Computes the torques that are logged, but not written.
        frames: Counts the lost frames.
    """
    return RealtimeSetup(partial(_limp_robot, make_rig, robot_control, frames), robot_control)


def _limp_robot(make_rig: Callable[[], Rig], robot_control: RobotControl, frames: FrameCount) -> LimpRig:
    rig = make_rig()
    return LimpRig(rig, robot_control.limp_limits(rig), frames)

"""Sessions of a robot that gets no torque."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from math import isfinite
from time import sleep

import numpy as np

from stepgap.base.signals import terminated_as_interrupted
from stepgap.hardware.realtime.process import RealtimeSetup
from stepgap.hardware.realtime.session import Session, TickSink
from stepgap.plants.tick_control import RobotControl
from stepgap.plants.ticks.rig_state import RigState
from stepgap.plants.ticks.tick_table import TickTable
from stepgap.rigs.limits import RigLimits
from stepgap.rigs.rig import Rig, RigFault, Torques
from stepgap.rigs.wrapped_rig import WrappedRig
from stepgap.step import Array


class LimpRig(WrappedRig):
    """Reads a rig and always writes zero torque; after its warning a limp robot is switched off.

    Args:
        limits: Limits that stop it: those of lost frames, but neither those of pose nor of speed.
    """

    def __init__(self, rig: Rig, limits: RigLimits):
        super().__init__(rig)
        self._limits = limits

    @property
    def limits(self) -> RigLimits:
        """Limits as given."""
        return self._limits

    def write(self, torques: Torques) -> Torques:
        """Writes zero torque instead of the given torques."""
        return self._rig.write((0.0,) * len(torques))


_CHECK_EVERY = 0.05  # Time between two checks whether there are enough ticks [s]


@dataclass(frozen=True)
class LimpTicks:
    """Ticks of a rig without torque, from the first one on.

    Attributes:
        table: The ticks, at least one.
        lost_frames: Number of frames that were lost.
        refused: The requests that the kernel refused; empty if there were none.
        fault: Why there are fewer ticks than requested; empty if there are not.
    """

    table: TickTable
    lost_frames: int
    refused: str
    fault: str


def ticks_of(setup: RealtimeSetup, count: int) -> LimpTicks:
    """Runs a rig for a number of ticks, without a request to step.

    Raises:
        RigFault: There was no tick at all.
    """
    kept = _Memory()
    refused = ""
    with Session(setup, kept) as session, terminated_as_interrupted():
        while kept.count < count and not session.over():
            sleep(_CHECK_EVERY)
            if session.board.state in (RigState.CALIBRATE, RigState.READY):
                refused = refused or session.message()
        fault = ended(session)
        lost = session.board.lost_frames
    if not kept.count:
        raise RigFault(fault)
    return LimpTicks(TickTable(setup.units, np.concatenate(kept.blocks)[:count]), lost, refused, fault)


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


@contextmanager
def limp_robot(setup: RealtimeSetup) -> Iterator[Callable[[], Mapping[str, float]]]:
    """Runs a limp robot, set up by `limp_setup`, within the block; yields a function that returns its last tick.

    Raises:
        RigFault: The rig failed.
    """
    last = LastTick(setup.units)
    with Session(setup, last) as session, terminated_as_interrupted():

        def look() -> Mapping[str, float]:
            session.check()
            return last.fields

        while not look():
            sleep(_CHECK_EVERY)
        yield look


def describe_devices(rig: Rig, fields: Mapping[str, float]) -> dict[str, str]:
    """Describes what the rig itself judges in a tick: temperatures, bus voltages and states of inputs of its drives."""
    names = rig.diagnostic_names
    units = rig.diagnostic_units
    judged = {name: fields[name] for name in units if name in fields and name in {*names, *rig.diagnostic_ranges}}
    return {
        name: names[name].get(round(value), f"{value:g}") if name in names else f"{value:.1f} {units[name]}"
        for name, value in judged.items()
        if isfinite(value)
    }


def limp_setup(make_rig: Callable[[], Rig], robot_control: RobotControl) -> RealtimeSetup:
    """Creates the setup of a robot that gets no torque.

    Args:
        make_rig: Creates its rig; it must be possible to pickle it.
        robot_control: Computes the torques that are logged, but not written.
    """
    return RealtimeSetup(partial(_limp_robot, make_rig, robot_control), robot_control)


def _limp_robot(make_rig: Callable[[], Rig], robot_control: RobotControl) -> LimpRig:
    rig = make_rig()
    return LimpRig(rig, robot_control.limp_limits(rig))

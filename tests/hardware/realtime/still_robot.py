"""A robot that only stands there, for tests of what is around its control; it needs no compiled code."""

# ruff: noqa: ARG002
# (The interfaces give more than a robot needs that stands still.)

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from stepgap.hardware.hopper.still import StillRig
from stepgap.hardware.realtime.process import RealtimeSetup
from stepgap.plants.tick_control import FinishedStep, Order, RobotControl, TickControl, TickFlag
from stepgap.plants.ticks.log_description import FieldMeaning
from stepgap.plants.ticks.tick_table import TickTable
from stepgap.rigs.limits import RigLimits
from stepgap.rigs.rig import HEALTHY, Health, Reading, Rig, SensorModel, Torques
from stepgap.step import Quantity, StepSpace, StepStatus

UNITS = {"time": "s", "position": "rad"}
SPACE = StepSpace(
    (Quantity("speed", "m/s", 0.0, 1.0),),
    (Quantity("fx", "N", -1.0, 1.0), Quantity("fy", "N", -1.0, 1.0), Quantity("angle", "rad", -1.0, 1.0)),
)


class StillControl(TickControl):
    """Gives no torque, and stops at an emergency stop only; its steps do not end."""

    def __init__(self) -> None:
        self._row, self._stopped = (0.0, 0.0), False

    @property
    def units(self) -> Mapping[str, str]:
        return UNITS

    @property
    def motors(self) -> int:
        return 1

    def tick(
        self,
        time: float,
        reading: Reading,
        order: Order,
        applied: Torques,
        health: Health = HEALTHY,
        age: float = 0.0,
    ) -> tuple[Torques, int]:
        self._row, self._stopped = (time, *reading), self._stopped or health.emergency_stop
        return (0.0,), TickFlag.STOPPED if self._stopped else TickFlag.NOTHING

    def row(self, applied: Torques) -> Sequence[float]:
        return self._row

    def finished_step(self) -> FinishedStep:
        return self.failed_step(None)

    def failed_step(self, applied: Torques | None) -> FinishedStep:
        return FinishedStep.stopped(SPACE)

    @property
    def status(self) -> StepStatus:
        return StepStatus.STOPPED if self._stopped else StepStatus.OK

    @property
    def stopped(self) -> str:
        return "emergency stop" if self._stopped else ""


@dataclass(frozen=True)
class StillRobot(RobotControl):
    """Makes a `StillControl`."""

    @property
    def space(self) -> StepSpace:
        return SPACE

    @property
    def units(self) -> Mapping[str, str]:
        return UNITS

    @property
    def consent_request(self) -> str:
        return "Hold the space bar."

    def meaning(self, rig: Rig) -> FieldMeaning:
        return FieldMeaning()

    def control(self, rig: Rig) -> StillControl:
        return StillControl()

    def limp_limits(self, rig: Rig) -> RigLimits:
        return RigLimits()

    def step_ends(self, ticks: TickTable) -> np.ndarray:
        return np.empty(0, int)

    def describe(self, rig: Rig, tick: Mapping[str, float]) -> dict[str, str]:
        return {}


def still_rig() -> StillRig:
    """A slow rig without hardware, of which a busy machine misses few ticks."""
    return StillRig(SensorModel(tick=0.01), (0.5,))


SETUP = RealtimeSetup(still_rig, StillRobot())


class Sink:
    """Stores ticks, or fails with a given error."""

    def __init__(self, error=None):
        self.rows, self.events, self.closed, self._error = [], [], 0, error

    def append(self, rows):
        self.rows += rows.tolist()
        if self._error and self.rows:
            raise self._error

    def note(self, event):
        self.events.append(event)

    def flush(self): ...

    def close(self):
        self.closed += 1

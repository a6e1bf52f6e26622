"""Record of one tick of the control loop, for logs and viewers."""

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import NamedTuple, Self

from stepgap.plants.realtime.loop import LOOP_UNITS
from stepgap.rigs.rig import Torques
from stepgap.robots.hopper.phases import Phase
from stepgap.robots.hopper.safety import Limited
from stepgap.robots.hopper.sensors import HopperReading

TICK_UNITS: Mapping[str, str] = MappingProxyType(
    {
        "time": "s",
        "motor_1": "counts",
        "motor_2": "counts",
        "boom_horizontal": "counts",
        "boom_vertical": "counts",
        "contact_force": "N",
        "phase": "",
        "alpha_1": "rad",
        "alpha_2": "rad",
        "asked_1": "N·m",
        "asked_2": "N·m",
        "applied_1": "N·m",
        "applied_2": "N·m",
        "limited": "",
    }
)
"""Fields of a tick in the order of a log row, with their units; `phase` and `limited` are the numbers of the enums."""


LOG_UNITS: Mapping[str, str] = MappingProxyType({**TICK_UNITS, **LOOP_UNITS})
"""Fields of a row of a real-time process's tick log, with their units."""


class Tick(NamedTuple):
    """One tick of the control loop; angles [rad], torques [N·m].

    Attributes:
        time: Time since the start [s].
        reading: Sensor values.
        phase: Detected phase of the hop.
        alpha_1: Mean angle of the top links α₁.
        alpha_2: Half the angle between the top links α₂.
        asked: Torques that the control law requested.
        applied: Torques that the rig reports as applied.
        limited: Reasons why they differ.
    """

    time: float
    reading: HopperReading
    phase: Phase
    alpha_1: float
    alpha_2: float
    asked: tuple[float, float]
    applied: Torques
    limited: Limited

    @classmethod
    def of(cls, row: Sequence[float]) -> Self:
        """Converts a log row with the fields of `TICK_UNITS`."""
        time, *reading, phase, alpha_1, alpha_2, asked_1, asked_2, applied_1, applied_2, limited = map(float, row)
        return cls(
            time,
            HopperReading(*reading),
            Phase(int(phase)),
            alpha_1,
            alpha_2,
            (asked_1, asked_2),
            (applied_1, applied_2),
            Limited(int(limited)),
        )

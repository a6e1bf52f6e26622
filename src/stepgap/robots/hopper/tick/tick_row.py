"""Record of one tick of the control loop, for logs and viewers."""

from collections import namedtuple
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import NamedTuple, Self

from stepgap.rigs.rig import Torques
from stepgap.robots.hopper.tick.phases import Phase
from stepgap.robots.hopper.tick.safety import Limited
from stepgap.robots.hopper.tick.sensors import HopperReading

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
        "rate_1": "rad/s",
        "rate_2": "rad/s",
        "joint_speed": "rad/s",
        "leg_length": "m",
        "measured_height": "m",
        "height_above_ground": "m",
    }
)
"""Fields of a tick in the order of a log row, with their units; `phase` and `limited` are the numbers of the enums.

Angles, `joint_speed` = |α̇₁| + |α̇₂|, `leg_length` and the hip's `height_above_ground` are what the safety function
judges. That is its `measured_height` above the zero of the boom less, where the ground is measured, the height at which
the foot found it in the last touchdown.
"""

TickRow = namedtuple("TickRow", TICK_UNITS)
"""A log row whose numbers have names."""

TICK_COLUMN = TickRow(*range(len(TICK_UNITS)))
"""Index of each field in a log row; an attribute of it is a constant in compiled code."""

TICK_NAMES: Mapping[str, Mapping[int, str]] = MappingProxyType({"phase": {phase.value: phase.name for phase in Phase}})
"""Names of the numbers of an enum in a field."""

TICK_BITS: Mapping[str, Mapping[int, str]] = MappingProxyType(
    {"limited": {reason.value: reason.name or "" for reason in Limited}}
)
"""Names of the bits of a field."""


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
        rate_1: α̇₁ [rad/s].
        rate_2: α̇₂ [rad/s].
        joint_speed: |α̇₁| + |α̇₂| [rad/s].
        leg_length: ℓ [m].
        measured_height: y of the hip above the zero of the boom, as measured [m].
        height_above_ground: The same above the ground of the last touchdown, where that is measured [m].
    """

    time: float
    reading: HopperReading
    phase: Phase
    alpha_1: float
    alpha_2: float
    asked: tuple[float, float]
    applied: Torques
    limited: Limited
    rate_1: float
    rate_2: float
    joint_speed: float
    leg_length: float
    measured_height: float
    height_above_ground: float

    @classmethod
    def of(cls, row: Sequence[float]) -> Self:
        """Converts a log row with the fields of `TICK_UNITS`."""
        fields = TickRow(*map(float, row))
        return cls(
            time=fields.time,
            reading=HopperReading(*(getattr(fields, name) for name in HopperReading._fields)),
            phase=Phase(int(fields.phase)),
            alpha_1=fields.alpha_1,
            alpha_2=fields.alpha_2,
            asked=(fields.asked_1, fields.asked_2),
            applied=(fields.applied_1, fields.applied_2),
            limited=Limited(int(fields.limited)),
            rate_1=fields.rate_1,
            rate_2=fields.rate_2,
            joint_speed=fields.joint_speed,
            leg_length=fields.leg_length,
            measured_height=fields.measured_height,
            height_above_ground=fields.height_above_ground,
        )

"""Record of one tick of the control loop, for logs and viewers."""

from collections import namedtuple
from collections.abc import Mapping
from types import MappingProxyType

from stepgap.robots.hopper.tick.phases import Phase
from stepgap.robots.hopper.tick.safety import Limited

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

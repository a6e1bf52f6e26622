"""Rows of a rig's tick log from ticks of the twin."""

import numpy as np

from stepgap.hardware.realtime.loop import LOOP_UNITS
from stepgap.plants.ticks.rig_state import RigState
from stepgap.robots.hopper.tick.tick_row import TICK_UNITS
from stepgap.step import Array

LOG_UNITS = {**TICK_UNITS, **LOOP_UNITS}
"""Fields of a log of the hopper on a rig without diagnostics."""


def rig_rows(ticks: Array, state: RigState) -> Array:
    """Appends the fields of the control loop to ticks; none is late, and the robot is always in one state."""
    values = [state if name == "state" else 0.0 for name in LOOP_UNITS]
    return np.column_stack([ticks, np.tile(values, (len(ticks), 1))])

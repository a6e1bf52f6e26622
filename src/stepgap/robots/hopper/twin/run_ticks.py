"""Control, drives, physics and sensors of the twin, tick after tick, as one compiled function."""

import numpy as np

from stepgap.base.compiled import as_written
from stepgap.plants.tick_control import TickFlag
from stepgap.robots.hopper.tick.hop_tick import UNREADABLE, tick
from stepgap.robots.hopper.tick.tick_row import TICK_COLUMN
from stepgap.robots.hopper.twin.devices import READ, drive, read_counts
from stepgap.robots.hopper.twin.physics import move
from stepgap.robots.hopper.twin.true_apex import update_apex

NO_NUMBER = 3
NO_TORQUE = 4
"""How a tick ended, besides the outcomes of a reading: a sensor value or a torque is not finite."""

_ENDS_RUN = int(TickFlag.STEP_ENDED | TickFlag.FAILED | TickFlag.TOUCHDOWN)


@as_written
def run_ticks(
    control, devices, views, physics, apex, noise, rows, time, tick_time, mode, share, force_x, force_y, applied_1,
    applied_2,
):  # fmt: skip
    """Runs ticks until a foot touches down, or a step ends or fails, at most as many as `rows` has.

    Args:
        control: Records of `TickSettings` and `HopState`, and a row of the tick log.
        devices: Record of `Devices`.
        views: `Views`.
        physics: `Physics`.
        apex: Record of `TrueApex`.
        noise: Standard normal numbers for each tick and motor; shape (k, 2).
        rows: Rows of the tick log, which are filled; shape (k, fields).
        time: When the first tick begins [s].
        tick_time: Time from one tick to the next [s].
        mode: This and the other arguments are fields of `TickInputs`.

    Returns:
        Number of ticks, how the last one ended, its flags, the time of the next tick, and the torques applied.
    """
    settings, memory, row = control
    flags = 0
    for i in range(len(rows)):
        counts, outcome = read_counts(devices, views)
        if outcome != READ:
            return i, outcome, flags, time, applied_1, applied_2
        torques, flags = tick(
            settings, memory, row, time, 0.0, counts[0], counts[1], counts[2], counts[3], counts[4], False, False, 0,
            False, mode, share, force_x, force_y, applied_1, applied_2,
        )  # fmt: skip
        if flags & UNREADABLE:
            return i, NO_NUMBER, flags, time, applied_1, applied_2
        applied = drive(devices, torques[0], torques[1], noise[i], views)
        if np.isnan(applied[0]):
            return i, NO_TORQUE, flags, time, applied_1, applied_2
        applied_1, applied_2 = applied
        move(devices, views, physics)
        update_apex(apex, devices, views)
        time += tick_time
        for column in range(len(row)):  # an assignment of arrays would compile the text of its error, for seconds
            rows[i, column] = row[column]
        rows[i, TICK_COLUMN.applied_1] = applied_1
        rows[i, TICK_COLUMN.applied_2] = applied_2
        if flags & _ENDS_RUN:
            return i + 1, READ, flags, time, applied_1, applied_2
    return len(rows), READ, flags, time, applied_1, applied_2

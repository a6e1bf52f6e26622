"""Commands that hold until the next one, and the sections of steps of equal length while they hold.

A log whose motion comes before its commands has clocks that differ: `command_lag`.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final, final

import numpy as np
from numpy.typing import NDArray

from stepgap.logs.sections.plans import StepValues
from stepgap.logs.sections.section_finding import FoundSection
from stepgap.logs.sections.signals import Signal
from stepgap.step import Array

LASTING: Final = 5.0
"""A command that is not followed by another one is known for this many times the usual time between two of them."""

SLACK: Final = 0.1  # A step may be longer or shorter by this part, so that it ends where the command changes
CELLS: Final = 10  # Number of parts of a step in which the motion is compared with the command
MOST_CELLS: Final = 6000  # Number of these parts, from the begin of the log on, that are compared

EXPLAINED: Final = 0.2
"""Least part of the variance of a velocity that its commands must explain, for the lag to be known."""


@final
@dataclass(frozen=True, eq=False)
class HeldCommands:
    """Commands as a function of time, which is constant between J times.

    Attributes:
        begin: Time from which each command holds, until the next of these times [s]; shape (J,).
        values: The commands, NaN where one is not known; shape (J, m).
    """

    begin: Array
    values: Array

    def at(self, time: Array) -> NDArray[np.intp]:
        """Index of the command that holds at each time; −1 before the first."""
        return np.searchsorted(self.begin, time, "right") - 1


def held_commands(signals: Sequence[Signal], hold: float = 0.0) -> HeldCommands:
    """The commands in signals, one for each coordinate.

    Args:
        signals: Each has a sample for each command, whether it is a new one or not.
        hold: How long a command holds if no other one follows [s]; 0 for `LASTING`.
    """
    lasting = [hold or LASTING * signal.interval for signal in signals]
    expired = [signal.time + last for signal, last in zip(signals, lasting, strict=True)]
    time = np.unique(np.concatenate([*(signal.time for signal in signals), *expired]))
    columns: list[Array] = []
    for signal, last in zip(signals, lasting, strict=True):
        latest = np.searchsorted(signal.time, time, "right") - 1
        holds = (latest >= 0) & (time - signal.time[latest] < last - 1e-6)  # times since 1970 are rounded to 0.24 µs
        columns.append(np.where(holds, np.asarray(signal.values, float)[latest], np.nan))
    values = np.stack(columns, axis=-1)
    same = (values[1:] == values[:-1]) | (np.isnan(values[1:]) & np.isnan(values[:-1]))
    new = np.append(True, ~same.all(axis=1))
    return HeldCommands(time[new], values[new])


def regular_sections(commands: HeldCommands, every: float, first: float, last: float) -> list[FoundSection]:
    """Sections between two times [s]: where the command changes, then at intervals `every` [s] as long as it holds."""
    sections: list[FoundSection] = []
    for (begin, end), values in zip(pairwise(commands.begin.tolist()), commands.values, strict=False):
        if not np.isfinite(values).all():
            continue
        # Equal intervals; the last time is the end of the command if that is near.
        times = begin + every * np.arange(int((end - begin) / every + SLACK) + 1)
        if len(times) == 1:
            continue
        if abs(end - times[-1]) <= SLACK * every:
            times[-1] = end
        # The begin is there already where a command before has ended at it.
        if not (sections and sections[-1].time == begin):
            sections.append(FoundSection(begin, since=begin - every))
        sections += [FoundSection(time, since=before) for before, time in pairwise(times.tolist())]
    return [section for section in sections if first <= section.time <= last]


def held_in_steps(commands: HeldCommands, sections: Sequence[FoundSection], every: float) -> StepValues:
    """For each step between successive sections, the command that holds in it; values of shape (K − 1, m).

    A step has none if the command changed before it had ended, and neither if another change was less than this time
    before it: the mean over this time does not say then how the robot moved when the step began.
    """
    time, since = (np.array([getattr(section, name) for section in sections]) for name in ("time", "since"))
    held = commands.at(time)
    before = commands.at(since + SLACK * every)
    is_complete = np.append(np.isfinite(commands.values).all(axis=1), False)  # the last is that of the index −1
    previous = commands.at(np.nextafter(time, -np.inf))
    doubts: list[str] = []
    for number in range(len(time) - 1):
        if since[number + 1] != time[number]:
            doubts.append(f"the command changes within {every:g} s")
        elif not is_complete[previous[number]]:
            doubts.append("no command is known before it")
        elif before[number] != previous[number]:
            doubts.append(f"another change of the command less than {every:g} s before it")
        else:
            doubts.append("")
    return StepValues(commands.values[held[:-1]], tuple(doubts))


def command_lag(cells: Array, motion: Sequence[Array], commands: HeldCommands) -> float:
    """The lag of the commands with which a linear function of them explains the motion best [s].

    Args:
        cells: Times that divide the log evenly [s]; shape (G + 1,).
        motion: Mean of each velocity between these times, NaN where it is not known; each of shape (G,).

    Returns:
        One of the lags up to a step, positive where the motion comes later; NaN if the motion does not follow them.
    """
    lags = np.arange(-CELLS, CELLS + 1) * float(cells[1] - cells[0])
    middle = (cells[1:] + cells[:-1]) / 2
    at = commands.at(middle - lags[:, None])
    inputs = np.where((at >= 0)[..., None], commands.values[at], np.nan)
    velocities = np.stack(motion, axis=-1)
    complete = np.isfinite(inputs).all(axis=(0, 2)) & np.isfinite(velocities).all(axis=1)
    spread = velocities[complete].std(axis=0) if complete.any() else np.zeros(len(motion))
    if not (spread > 0).all() or complete.sum() < 2 * CELLS:
        return np.nan
    wanted = (velocities[complete] - velocities[complete].mean(axis=0)) / spread
    unexplained = [_unexplained(lagged[complete], wanted) for lagged in inputs]
    best = int(np.argmin(unexplained))
    return float(lags[best]) if unexplained[best] < 1 - EXPLAINED else np.nan


def _unexplained(inputs: Array, wanted: Array) -> float:
    """Mean square of what an affine function of the inputs leaves of outputs with variance 1."""
    basis = np.column_stack([inputs, np.ones(len(inputs))])
    return float(np.mean((wanted - basis @ np.linalg.lstsq(basis, wanted, rcond=None)[0]) ** 2))

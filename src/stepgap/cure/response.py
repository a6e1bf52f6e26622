"""How a robot follows its commands: with which delay, lag and gains, and the period of its gait."""

from dataclasses import dataclass, replace
from math import nan
from typing import Final

import numpy as np
from scipy.signal import lfilter

from stepgap.base.errors import InputError
from stepgap.cure.drive import AXIS_NAMES, CELL, HandDrive
from stepgap.mujoco_robots.velocity.gait import Gait, gait_period
from stepgap.step import Array

_DELAYS: Final = np.arange(-25, 51)  # Delays that are tried [cells]
_LAGS: Final = (0.0, 0.05, 0.1, 0.15, 0.2, 0.3, 0.45, 0.7)  # Time constants that are tried [s]
_CLEARLY: Final = 0.02  # Part of the variance by which a delay explains more that is not by chance
_LONGEST: Final = 600.0  # Part of a log from which delay and lag are found [s]
EARLY: Final = 0.05  # The motion may seem to come before the commands by this time [s]

LEAST_FOLLOWED: Final = 0.2
"""Least part of the variance of the velocities that commands must explain: otherwise they are not the robot's."""

_OWN: Final = 0.3  # A command moves another velocity if its gain for its own is a smaller part of that for the other

_FASTEST: Final = 10.0  # No walking robot is told, or does for a tenth of the time, more than this [m/s, rad/s]
_MOST_GAIN: Final = 5.0  # Nor does it do so many times what it is told

_WINDOW: Final = 10.0  # Part of a log in which the motion must follow its commands as in the whole log [s]
_ASTRAY: Final = 0.3  # It does not where its gain is a smaller part of that of the whole log,
_ENOUGH: Final = 0.2  # and its commands vary at least by this part of the variance of all

DRIVEN: Final = 0.05
"""A velocity was commanded if its commands differ by this [m/s, rad/s]."""

_SETTLED, _PIECE = 0.8, 2.4
"""A piece for the period of the gait begins this time after a change of the command, and has this duration [s]."""

STEP: Final = 0.5  # About the duration of a step [s]


@dataclass(frozen=True, eq=False)
class Response:
    """How the velocities follow the commands: y(t) = gains · lagged command(t − delay) + drift.

    Attributes:
        delay: Time by which the motion follows later than by its lag alone [s].
        lag: Time constant [s].
        gains: ∂velocity/∂command; shape (3, 3), zero for a velocity that was not commanded.
        drift: Velocity at the command zero; shape (3,).
        explained: Part of the variance of each velocity that the commands explain; shape (3,).
        driven: Which velocities were commanded.
        noise: Standard deviation of what the commands leave of the mean velocity over a step; shape (3,).
        period: Period of the gait [s], NaN if it is not known.
        height: How strictly it repeats, at most 1.
    """

    delay: float
    lag: float
    gains: Array
    drift: Array
    explained: Array
    driven: tuple[bool, ...]
    noise: Array
    period: float
    height: float

    @property
    def step(self) -> float:
        """Duration of a step: whole periods of the gait, if it is strictly periodic [s]."""
        seconds = Gait(self.period, self.height, (), ()).whole_steps(STEP)
        return min(max(seconds, 0.3), 1.2)

    def in_words(self) -> str:
        """Delay, lag and period as sentences."""
        if np.isfinite(self.period):
            gait = f"Its gait repeats every {self.period:.3g} s (autocorrelation {self.height:.2f})"
        else:
            gait = "No period of its gait is seen"
        return (
            f"The robot begins to follow a command after {max(self.delay, 0.0):.2f} s, and does 63 % of the change "
            f"within {self.lag:.2g} s from then on. {gait}; a step is {self.step:.3g} s."
        )


def response_of(drive: HandDrive) -> Response:
    """Finds delay, lag, gains and period.

    Raises:
        InputError: The velocities do not follow the commands, come before them or much later, go the other way, or have
            another unit.
    """
    _, velocity, given = drive.on_grid()
    rows = slice(0, round(_LONGEST / CELL))
    velocity, given = velocity[rows], given[rows]
    _check_sizes(drive, velocity, given)
    driven = tuple(bool(np.nanmax(column) - np.nanmin(column) > DRIVEN) for column in given.T)
    if not any(driven):
        raise InputError(f"{drive.log.source}: its command never changes, so nothing is seen of what commands do")
    delay, lag = _delay_and_lag(velocity, given, driven)
    lagged = _lagged(given, lag)
    gains, drift, explained = _fitted(velocity, lagged, round(delay / CELL), driven)
    _check(drive, delay, gains, explained, driven)
    period, height = _gait(drive)
    later, earlier = _pairs(velocity, lagged, round(delay / CELL))
    noise = _scatter(later - earlier @ gains.T - drift)
    response = Response(delay, lag, gains, drift, explained, driven, noise, period, height)
    # A command must be seen in the next step at the latest; the largest delay that is tried may not be the right one.
    if delay >= min(response.step, CELL * _DELAYS[-1]):
        raise InputError(
            f"{drive.log.source}: the motion begins to follow its commands after {delay:.2g} s or more, which is "
            f"longer than a step of {response.step:.2g} s, so clocks differ, or the odometry is late; record both on "
            "one computer, or give both a header.stamp by one clock"
        )
    return response


def with_strays(drive: HandDrive, response: Response) -> HandDrive:
    """The drive with a note on the parts in which the motion does not follow its commands, as of a carried robot."""
    time, velocity, given = drive.on_grid()
    late = max(0, round(response.delay / CELL))
    axes = np.flatnonzero(response.driven)
    expected = (_lagged(given, response.lag) @ response.gains.T)[: len(time) - late, axes]
    scale = np.maximum(np.nanstd(expected, axis=0), 1e-9)
    expected = expected / scale
    done = velocity[late:, axes] / scale
    size = round(_WINDOW / CELL)
    begins = list[float]()
    for first in range(0, len(done) - size + 1, size // 2):
        pairs = np.stack([expected[first : first + size], done[first : first + size]])
        pairs = pairs[:, np.isfinite(pairs).all(axis=(0, 2))]
        if pairs.shape[1] < size / 2:
            continue
        told, did = pairs - pairs.mean(axis=1, keepdims=True)
        if np.mean(told**2) > _ENOUGH and np.sum(told * did) < _ASTRAY * np.sum(told**2):
            begins.append(float(time[first] - time[0]))
    if not begins:
        return drive
    parts = ", ".join(f"{begin:.0f} to {begin + _WINDOW:.0f}" for begin in begins[:6])
    note = (
        f"From {parts} s after its begin the motion does not follow its commands, as if the robot was carried, had "
        "fallen or was driven by somebody else. This makes the correction wrong: cut these parts out of the log."
    )
    return replace(drive, notes=(*drive.notes, note))


def _scatter(errors: Array) -> Array:
    """Standard deviation of means over about a step; (G, 3) to (3,)."""
    size = round(STEP / CELL)
    count = len(errors) // size
    return errors[: count * size].reshape(count, size, -1).mean(axis=1).std(axis=0)


def after_lag(given: Array, lag: float) -> Array:
    """Numbers on a grid after a first-order lag, which begins with the first one; shape (G, m)."""
    share = CELL / (lag + CELL)
    return given[:1] + np.asarray(lfilter([share], [1, share - 1], given - given[:1], axis=0))


def _lagged(given: Array, lag: float) -> Array:
    """Commands after a first-order lag; unknown ones stay unknown."""
    if not lag:
        return given
    known = np.asarray(np.isfinite(given).all(axis=1))
    filled = np.where(known[:, None], given, 0.0)
    smooth = after_lag(filled, lag)
    # For three time constants after a gap, the lagged command is not known either.
    recent = np.convolve(~known, np.ones(round(3 * lag / CELL) + 1))[: len(known)] > 0
    return np.where((known & ~recent)[:, None], smooth, np.nan)


def _pairs(velocity: Array, given: Array, delay: int) -> tuple[Array, Array]:
    """Rows of velocities and of commands a number of cells before, where both are known."""
    size = len(velocity)
    begin, end = max(0, delay), min(size, size + delay)
    later = velocity[begin:end]
    earlier = given[begin - delay : end - delay]
    known = np.isfinite(np.hstack([later, earlier])).all(axis=1)
    return later[known], earlier[known]


def _delay_and_lag(velocity: Array, given: Array, driven: tuple[bool, ...]) -> tuple[float, float]:
    """The pair with which commands explain most; velocities count alike.

    A longer lag with a shorter delay explains about as much, so a negative delay must explain clearly more than others.
    """
    pairs = list[tuple[float, float, float]]()
    for lag in _LAGS:
        smooth = _lagged(given, lag)
        for delay in _DELAYS.tolist():
            left = float(np.mean(1 - _fitted(velocity, smooth, delay, driven)[2][np.array(driven)]))
            pairs.append((left, delay * CELL, lag))
    best = min(pairs)
    possible = min(pair for pair in pairs if pair[1] >= 0)
    _, delay, lag = best if best[0] < possible[0] - _CLEARLY else possible
    return delay, lag


def _fitted(velocity: Array, given: Array, delay: int, driven: tuple[bool, ...]) -> tuple[Array, Array, Array]:
    """Gains (3, 3), velocity at zero (3,), and the explained part of the variance (3,)."""
    later, earlier = _pairs(velocity, given, delay)
    columns = np.flatnonzero(driven)
    if len(later) < 100:
        return np.zeros((3, 3)), np.full(3, nan), np.zeros(3)
    basis = np.column_stack([earlier[:, columns], np.ones(len(later))])
    square = basis.T @ basis + 1e-9 * len(later) * np.eye(len(columns) + 1)
    weights = np.linalg.solve(square, basis.T @ later)
    left = later - basis @ weights
    gains = np.zeros((3, 3))
    gains[:, columns] = weights[:-1].T
    spread = np.maximum(later.var(axis=0), 1e-12)
    return gains, weights[-1], np.maximum(0.0, 1 - left.var(axis=0) / spread)


def _check_sizes(drive: HandDrive, velocity: Array, given: Array) -> None:
    for axis, name in enumerate(AXIS_NAMES):
        done = float(np.nanquantile(np.abs(velocity[:, axis]), 0.9))
        told = float(np.nanmax(np.abs(given[:, axis])))
        for what, size in (("command", told), ("velocity", done)):
            if size > _FASTEST:
                raise InputError(f"{drive.log.source}: the {what} of {name} is up to {size:.3g}; {_unit(axis)}")


def _unit(axis: int) -> str:
    """What is said of a velocity whose numbers are too large for a walking robot."""
    right, wrong = ("rad/s", "degrees per second") if AXIS_NAMES[axis] == "wz" else ("m/s", "mm/s, cm/s or percent")
    return f"commands and odometry must be in {right}: is this in {wrong}? Convert the column"


def _check(drive: HandDrive, delay: float, gains: Array, explained: Array, driven: tuple[bool, ...]) -> None:
    source = drive.log.source
    axes = np.flatnonzero(driven)
    if not np.max(explained[axes]) >= LEAST_FOLLOWED:
        shares = ", ".join(f"{AXIS_NAMES[axis]} {100 * explained[axis]:.0f} %" for axis in axes)
        raise InputError(
            f"{source}: the motion does not follow the commands, which explain {shares} of its variance; are they "
            "those that the robot got, is the odometry its own, and do both have the same clock?"
        )
    if delay < -EARLY:
        raise InputError(
            f"{source}: the motion comes {-delay:.2f} s before the commands that it follows, so their clocks differ; "
            "record both on one computer, or give both a header.stamp by one clock; or does the log lack commands that "
            "the robot got?"
        )
    for axis in axes.tolist():
        if abs(gains[axis, axis]) > _MOST_GAIN:
            raise InputError(
                f"{source}: the velocity {AXIS_NAMES[axis]} is {gains[axis, axis]:.3g} times its command; {_unit(axis)}"
            )
        most = int(np.argmax(np.abs(gains[:, axis])))
        if abs(gains[axis, axis]) < _OWN * abs(gains[most, axis]) and abs(gains[most, axis]) > _OWN:
            raise InputError(
                f"{source}: the command of {AXIS_NAMES[axis]} moves {AXIS_NAMES[most]} (gain {gains[most, axis]:.2f}), "
                f"and not {AXIS_NAMES[axis]} (gain {gains[axis, axis]:.2f}); are its columns in the order forward, "
                "left, turning?"
            )
        if gains[axis, axis] < -0.1 and explained[axis] >= LEAST_FOLLOWED:
            way = ("backward for forward", "to the right for to the left", "to the right for turning to the left")
            raise InputError(
                f"{source}: {AXIS_NAMES[axis]} goes the other way than its command (gain {gains[axis, axis]:.2f}: "
                f"{way[axis]}); forward, left and turning to the left must be positive in both (REP 103)"
            )


def _gait(drive: HandDrive) -> tuple[float, float]:
    """Period of the gait by the pieces of the log in which a command holds, and the height of its peak."""
    time, velocity, _ = drive.on_grid()
    size = round(_PIECE / CELL)
    pieces = list[Array]()
    ends = np.append(drive.commands.begin[1:], time[-1])
    for begin, end, command in zip(drive.commands.begin, ends, drive.commands.values, strict=True):
        if not (np.isfinite(command).all() and (np.abs(command) > DRIVEN).any()):
            continue
        first = int(np.searchsorted(time, begin + _SETTLED))
        last = int(np.searchsorted(time, end))
        for start in range(first, last - size + 1, size):
            piece = velocity[start : start + size]
            if np.isfinite(piece).all():
                pieces.append(piece)
    if len(pieces) < 3:
        return nan, 0.0
    return gait_period(np.array(pieces), CELL)

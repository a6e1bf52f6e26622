"""Logs of hops of which the truth is known, and what makes real logs worse."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from math import isfinite
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from stepgap.step import Array

GRAVITY, TOUCHDOWN, STIFFNESS = 9.81, 0.5, 900.0  # m/s², height of touch-down [m], of the leg per mass [1/s²]


@dataclass(frozen=True)
class HoppingLog:
    """A log of ticks with what is true of it.

    Attributes:
        time: Times [s]; shape (R,).
        height: Heights [m]; shape (R,), NaN where it is missing.
        forward: Positions [m]; likewise.
        flight: Whether the phase says flight; shape (R,).
        force: Force on the foot, per mass [m/s²]; shape (R,).
        apexes: Times, speeds and heights of the K apexes; shape (K, 3).
    """

    time: Array
    height: Array
    forward: Array
    flight: NDArray[np.bool_]
    force: Array
    apexes: Array


Change = Callable[[HoppingLog, np.random.Generator], HoppingLog]


def hopping(hops: int, rng: np.random.Generator, rate: float = 1000.0) -> HoppingLog:
    """A log of hops with random speeds and rises, without errors."""
    speeds, rises = rng.uniform(-0.5, 1.5, hops), rng.uniform(0.03, 0.12, hops)
    begin, position = 0.4, 0.0
    knots: list[tuple[float, float, float, float, float, bool]] = []  # begin, end, position, speed, launch, flight
    launch = 0.0
    for speed, rise in zip(speeds, rises, strict=True):
        launch = float(np.sqrt(2 * GRAVITY * rise))
        duration = 2 * launch / GRAVITY
        knots.append((begin, begin + duration, position, speed, launch, True))
        begin, position = begin + duration, position + speed * duration
        stance = (np.pi + 2 * np.arctan(GRAVITY / (np.sqrt(STIFFNESS) * launch))) / np.sqrt(STIFFNESS)
        knots.append((begin, begin + stance, position, speed, launch, False))
        begin, position = begin + stance, position + speed * stance
    time = np.arange(0, begin + 0.3, 1 / rate) + rng.uniform(0, 1 / rate)
    height, forward, flight = np.full(len(time), TOUCHDOWN), np.zeros(len(time)), np.zeros(len(time), bool)
    force = np.full(len(time), GRAVITY)
    for start, end, origin, speed, launch, airborne in knots:
        rows = (time >= start) & (time < end)
        since = time[rows] - start
        if airborne:
            height[rows] = TOUCHDOWN + launch * since - GRAVITY / 2 * since**2
        else:
            omega = np.sqrt(STIFFNESS)
            sag = GRAVITY / STIFFNESS
            height[rows] = TOUCHDOWN - sag + sag * np.cos(omega * since) - launch / omega * np.sin(omega * since)
        forward[rows], flight[rows] = origin + speed * since, airborne
        force[rows] = 0 if airborne else STIFFNESS * (TOUCHDOWN - height[rows])
    forward[time >= begin] = position
    tops = np.array(
        [
            (start + launch / GRAVITY, speed, TOUCHDOWN + launch**2 / (2 * GRAVITY))
            for start, _, _, speed, launch, airborne in knots
            if airborne
        ]
    )
    return HoppingLog(time, height, forward, flight, force, tops)


def rounded(step: float) -> Change:
    """Positions are rounded, as by an encoder."""
    return lambda log, _: replace(
        log, height=step * np.round(log.height / step), forward=step * np.round(log.forward / step)
    )


def noisy(std: float) -> Change:
    """Positions have normal noise [m]."""

    def change(log: HoppingLog, rng: np.random.Generator) -> HoppingLog:
        noise = rng.normal(0, std, (2, len(log.time)))
        return replace(log, height=log.height + noise[0], forward=log.forward + noise[1])

    return change


def vibrating(amplitude: float, frequency: float) -> Change:
    """A boom vibrates after each touch-down, at an amplitude [m] that decays in 0.1 s."""

    def change(log: HoppingLog, _: np.random.Generator) -> HoppingLog:
        landing = log.time[1:][log.flight[:-1] & ~log.flight[1:]]
        since = log.time - np.append(-np.inf, landing)[np.searchsorted(landing, log.time, "right")]
        vibration = amplitude * np.sin(2 * np.pi * frequency * np.minimum(since, 10)) * np.exp(-since / 0.1)
        return replace(log, height=log.height + vibration)

    return change


def weak_force(std: float, offset: float) -> Change:
    """The force has noise and an offset [m/s²]."""
    return lambda log, rng: replace(log, force=log.force + offset + rng.normal(0, std, len(log.force)))


def _rows(log: HoppingLog, keep: NDArray[np.bool_]) -> HoppingLog:
    return replace(
        log,
        time=log.time[keep],
        height=log.height[keep],
        forward=log.forward[keep],
        flight=log.flight[keep],
        force=log.force[keep],
    )


def lost_rows(count: int, longest: float) -> Change:
    """Rows are lost for random times up to `longest` [s]."""

    def change(log: HoppingLog, rng: np.random.Generator) -> HoppingLog:
        keep = np.ones(len(log.time), bool)
        for begin in rng.uniform(log.time[0], log.time[-1], count):
            keep &= (log.time < begin) | (log.time > begin + rng.uniform(0, longest))
        return _rows(log, keep)

    return change


def lost_values(share: float) -> Change:
    """Single values are missing, or those of a sensor that returns zero."""

    def change(log: HoppingLog, rng: np.random.Generator) -> HoppingLog:
        kind = rng.uniform(size=len(log.time))
        height = np.where(kind < share, np.nan, np.where(kind < 2 * share, 0.0, log.height))
        return replace(log, height=height, forward=np.where(kind > 1 - share, np.nan, log.forward))

    return change


def repeated(count: int, longest: float) -> Change:
    """The sensor repeats its value for random times up to `longest` [s]."""

    def change(log: HoppingLog, rng: np.random.Generator) -> HoppingLog:
        height, forward = log.height.copy(), log.forward.copy()
        for begin in rng.uniform(log.time[0], log.time[-1], count):
            rows = np.flatnonzero((log.time >= begin) & (log.time <= begin + rng.uniform(0, longest)))
            if len(rows):
                height[rows], forward[rows] = height[rows[0]], forward[rows[0]]
        return replace(log, height=height, forward=forward)

    return change


def slower_forward(every: int) -> Change:
    """The position is sampled at a lower rate than the height."""
    return lambda log, _: replace(log, forward=np.where(np.arange(len(log.time)) % every == 0, log.forward, np.nan))


def slower(every: int) -> Change:
    """From the middle of the log on, only one row in `every` is written."""

    def change(log: HoppingLog, _: np.random.Generator) -> HoppingLog:
        rows = np.arange(len(log.time))
        return _rows(log, (rows < len(rows) / 2) | (rows % every == 0))

    return change


def glitches(count: int, longest: float) -> Change:
    """The phase is wrong for random times up to `longest` [s]."""

    def change(log: HoppingLog, rng: np.random.Generator) -> HoppingLog:
        flight = log.flight.copy()
        for begin in rng.uniform(log.time[0], log.time[-1], count):
            rows = (log.time >= begin) & (log.time <= begin + rng.uniform(0, longest))
            flight[rows] = ~flight[rows]
        return replace(log, flight=flight)

    return change


def write(log: HoppingLog, folder: Path, rng: np.random.Generator) -> None:
    """Writes log.csv and plan.csv; a plan is made shortly after its section, and its number is that of the step."""
    cells = [
        [f"{value:.9g}" if isfinite(value) else "" for value in column.tolist()]
        for column in (log.height, log.forward, log.force)
    ]
    rows = zip(log.time.tolist(), *cells, np.where(log.flight, "FLIGHT", "STANCE").tolist(), strict=True)
    (folder / "log.csv").write_text(
        "time,height,forward,force,phase\n" + "".join(f"{t:.6f},{h},{x},{f},{p}\n" for t, h, x, f, p in rows)
    )
    plans = log.apexes[:, 0] + rng.uniform(0.002, 0.05, len(log.apexes))
    (folder / "plan.csv").write_text("time,number\n" + "".join(f"{t:.6f},{k}\n" for k, t in enumerate(plans.tolist())))

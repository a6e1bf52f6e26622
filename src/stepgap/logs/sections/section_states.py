"""The state at each section, by parabolas fitted to the signals about it or means over steps, with standard errors."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, final

import numpy as np

from stepgap.logs.sections.local_fit import LocalFit, fit_parabola, noise_std_of, resolution_of, rounding_of
from stepgap.logs.sections.section_finding import FoundSection
from stepgap.logs.sections.section_settings import SectionSettings, SignalCoordinate
from stepgap.logs.sections.signals import Signal, SignalLog
from stepgap.logs.sections.step_means import step_means
from stepgap.records.steps_csv import RecordError
from stepgap.step import Array

WINDOW_PARTS: Final = (1.0, 0.7, 0.5, 0.35, 0.25)  # Windows that are tried, in parts of the longest one

BIAS: Final = 1.5
"""A window is too long if its estimates differ from those of a shorter one by more standard errors than this (RMS)."""

MORE_DOUBTS: Final = 0.05
"""A window is also too long if it makes a larger part of the sections doubtful that are not with a shorter one."""

LARGE_RESIDUALS: Final = 5.0
"""A fit is doubtful if its residuals are larger than those of a typical fit (RMS) by this factor,"""

SMALL_RESIDUALS: Final = 1e-3
"""and larger than this part of the range of its samples; a log of a simulation hardly has residuals."""

UNCERTAIN: Final = 5.0
"""A section is doubtful if a standard error is larger than a typical one by this factor,"""

IMPRECISE: Final = 0.1  # and larger than this part of the standard deviation of the state over all sections

_EXACT: Final = 1e-6
"""Errors below this part of the range of a signal are those of a part that rests; what is usual is that of the others.

A joint that rests in most hops would otherwise make the noise of all others unusual."""

MOST_SAMPLES_OFF: Final = 0.2  # A fit is doubtful if a larger part of its samples was left out


@final
@dataclass(frozen=True, eq=False)
class SectionStates:
    """What was estimated at the K sections of a log.

    Attributes:
        time: Times [s]; shape (K,).
        time_std: Their standard errors [s]; shape (K,).
        state: States; shape (K, n), NaN where it is unknown.
        std: Their standard errors; shape (K, n).
        doubts: Why a section, or its state, is doubtful; empty texts if it is not.
        window: Time before and after a section that was used [s]; NaN if all states are means over steps.
    """

    time: Array
    time_std: Array
    state: Array
    std: Array
    doubts: tuple[str, ...]
    window: float


def section_states(log: SignalLog, sections: Sequence[FoundSection], settings: SectionSettings) -> SectionStates:
    """Estimates time and state of the sections.

    The window is the longest one whose estimates agree with those of shorter windows within their standard errors
    (Lepski's method), unless the settings give it.

    Raises:
        RecordError: A column of the state is missing, or no section has enough samples about it.
    """
    coordinates = settings.coordinates("state")
    signals = [log.signal(each.column) for each in coordinates]
    height = log.signal(settings.height_column) if settings.at_apex else None
    estimator = _Estimator(sections, coordinates, signals, height, one_sided=settings.at != "apex")
    if height is None and all(each.mean for each in coordinates):
        return estimator(np.nan)
    longest = settings.window or _longest_window(sections)
    candidates = [estimator(longest * part) for part in (WINDOW_PARTS[:1] if settings.window else WINDOW_PARTS)]
    usable = [each for each in candidates if np.isfinite(each.state).all(axis=1).sum() > len(sections) / 2]
    if not usable:
        rate = 1 / max(signal.interval for signal in signals)
        raise RecordError(
            f"{log.source}: too few samples ({rate:.3g} per second) within {longest:.3g} s of most sections to "
            "estimate the state there; give --window"
        )
    for number, chosen in enumerate(usable):
        if all(_agree(chosen, shorter) for shorter in usable[number + 1 :]):
            return chosen
    return usable[-1]


def _longest_window(sections: Sequence[FoundSection]) -> float:
    """Two fifths of a typical flight if flights are known, else a fifth of the time between sections."""
    flights = np.array([each.end - each.begin for each in sections])
    if np.isfinite(flights).all():
        return 0.4 * float(np.median(flights))
    return 0.2 * float(np.median(np.diff([each.time for each in sections])))


def _agree(longer: SectionStates, shorter: SectionStates) -> bool:
    """Whether a longer window gives estimates as good as a shorter one, by `MORE_DOUBTS` and `BIAS`."""
    more = sum(bool(a and not b) for a, b in zip(longer.doubts, shorter.doubts, strict=True))
    if more > MORE_DOUBTS * len(longer.time):
        return False
    sure = np.array([not (a or b) for a, b in zip(longer.doubts, shorter.doubts, strict=True)])
    for i in range(longer.state.shape[1]):
        differences = (longer.state - shorter.state)[sure, i] / shorter.std[sure, i]
        known = differences[np.isfinite(differences)]
        if len(known) and np.sqrt(np.mean(known**2)) > BIAS:
            return False
    return True


@final
@dataclass(frozen=True, eq=False)
class _Estimator:
    """Estimates with a given window.

    Attributes:
        sections: The sections.
        coordinates: Coordinates of the state.
        signals: Their signals.
        height: The signal whose maximum is the section; None if the time of a section is known.
        one_sided: Whether the section is the begin or the end of the smooth motion.
    """

    sections: Sequence[FoundSection]
    coordinates: Sequence[SignalCoordinate]
    signals: Sequence[Signal]
    height: Signal | None
    one_sided: bool

    def __call__(self, window: float) -> SectionStates:
        """Time and state of all sections."""
        times = np.array([section.time for section in self.sections])
        time_std = np.array([section.time_std for section in self.sections])
        doubts = [list(section.doubts) for section in self.sections]
        if self.height is not None:
            tops = [self._top(section, window) for section in self.sections]
            _note_poor_fits(tops, self.height, doubts, "the top")
            noise = _noise_of(tops, self.height)
            for number, fit in enumerate(tops):
                if fit and np.isfinite(fit.top) and abs(fit.top - fit.centre) <= window:
                    times[number] = fit.top
                    time_std[number] = fit.top_std(noise[number])
                else:
                    doubts[number].append("no maximum of the height within the window")
        state, std = np.full((2, len(times), len(self.coordinates)), np.nan)
        for column, (coordinate, signal) in enumerate(zip(self.coordinates, self.signals, strict=True)):
            if coordinate.mean:
                state[:, column], std[:, column] = self._means(coordinate, signal, times, doubts)
                continue
            fits = [
                self._fit(signal, section, float(time), window)
                for section, time in zip(self.sections, times, strict=True)
            ]
            _note_poor_fits(fits, signal, doubts, coordinate.name)
            noise = _noise_of(fits, signal)
            for number, fit in enumerate(fits):
                if fit:
                    state[number, column], std[number, column] = _at(
                        fit, coordinate, float(times[number]), float(time_std[number]), noise[number]
                    )
            _note_uncertain(state[:, column], std[:, column], doubts, coordinate.name)
        texts = tuple("; ".join(dict.fromkeys(each)) for each in doubts)
        return SectionStates(times, time_std, state, std, texts, window)

    def _means(
        self, coordinate: SignalCoordinate, signal: Signal, times: Array, doubts: Sequence[list[str]]
    ) -> tuple[Array, Array]:
        """Means over the steps that end at the sections, and their standard errors; notes which are doubtful."""
        since = np.array([section.since for section in self.sections])
        begin = np.where(np.isnan(since), np.append(np.nan, times[:-1]), since)
        values, std, reasons = step_means(signal, begin, times, rate=coordinate.rate)
        for reason, found in zip(reasons, doubts, strict=True):
            if reason:
                found.append(f"{reason} of {coordinate.column}")
        return values, std

    def _top(self, section: FoundSection, window: float) -> LocalFit | None:
        """The parabola about the top, whose centre is moved to the top twice."""
        assert self.height is not None
        centre = section.time
        fit = None
        for _ in range(3):
            fit = self._fit(self.height, section, centre, window)
            if fit is None or not abs(fit.top - centre) <= window:
                break
            centre = fit.top
        return fit

    def _fit(self, signal: Signal, section: FoundSection, time: float, window: float) -> LocalFit | None:
        margin = 0.0 if self.one_sided else min(0.05 * (section.end - section.begin), window)
        margin = margin if np.isfinite(margin) else 0.0
        begin = max(time - window, section.begin + margin)
        end = min(time + window, section.end - margin)
        return fit_parabola(signal, time, begin, end) if begin < end else None


def _at(fit: LocalFit, coordinate: SignalCoordinate, time: float, time_std: float, noise: float) -> tuple[float, float]:
    """Value of a coordinate at a time, and its standard error, which contains that of the time."""
    if coordinate.rate:
        return fit.rate(time), float(np.hypot(fit.rate_std(time, noise), fit.acceleration * time_std))
    return fit.value(time), float(np.hypot(fit.value_std(time, noise), fit.rate(time) * time_std))


def _noise_of(fits: Sequence[LocalFit | None], signal: Signal) -> list[float]:
    """Standard deviation of the samples of each fit; NaN where there is none."""
    found = [fit for fit in fits if fit]
    known = iter(noise_std_of(found, resolution_of(signal)).tolist() if found else [])
    return [next(known) if fit else float("nan") for fit in fits]


def _note_uncertain(state: Array, std: Array, doubts: Sequence[list[str]], name: str) -> None:
    """Notes which standard errors of a coordinate are large."""
    if not np.isfinite(std).any():
        return
    spread = float(np.nanstd(state))
    typical = _usual(std, max(_EXACT * spread, rounding_of(state[np.isfinite(state)])))
    for each, found in zip(std, doubts, strict=True):
        if each > max(UNCERTAIN * typical, IMPRECISE * spread):
            found.append(f"the standard error of {name} is {each / typical:.0f} times as large as usual")


def _note_poor_fits(fits: Sequence[LocalFit | None], signal: Signal, doubts: Sequence[list[str]], name: str) -> None:
    """Notes which fits fail or are much worse than a typical one."""
    values = np.asarray(signal.values, float)
    exact = max(_EXACT * float(np.ptp(values)), rounding_of(values))
    sizes = np.array([float(np.sqrt(np.mean(fit.residuals**2))) if fit else np.nan for fit in fits])
    typical = _usual(sizes, exact)
    for fit, size, found in zip(fits, sizes, doubts, strict=True):
        if fit is None:
            found.append(f"too few samples for {name}")
        elif fit.outliers > MOST_SAMPLES_OFF:
            found.append(f"{fit.outliers:.0%} of the samples for {name} are off")
        elif size > max(LARGE_RESIDUALS * typical, SMALL_RESIDUALS * fit.extent, exact):
            found.append(f"the samples for {name} do not fit a parabola")


def _usual(errors: Array, exact: float) -> float:
    """Median of the errors that are no smaller than what counts as exact; that if there are none."""
    known = errors[errors > exact]
    return float(np.median(known)) if len(known) else exact

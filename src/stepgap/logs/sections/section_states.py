"""The state at each section, by parabolas fitted to the signals about it or means over steps, with standard errors."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, final

import numpy as np
from numpy.typing import NDArray

from stepgap.logs.sections.section_finding import FoundSection
from stepgap.logs.sections.section_settings import SectionSettings, SignalCoordinate
from stepgap.logs.sections.signals import Signal, SignalLog, rounding_of
from stepgap.logs.sections.step_means import step_means
from stepgap.records.steps_csv import RecordError
from stepgap.step import Array

FEWEST_SAMPLES: Final = 6  # A parabola is fitted to at least this number of samples

OUTLYING: Final = 6.0
"""A sample whose residual exceeds this number of robust standard deviations, such as that of a dropout, is left out."""


UNUSUAL: Final = 2.0
"""A variance of residuals that is larger than the median of all fits by this factor is not due to chance."""


@final
@dataclass(frozen=True, eq=False)
class LocalFit:
    """A parabola, by least squares.

    Attributes:
        centre: Time that is zero in the basis [s].
        scale: Time that is one in the basis [s].
        coefficients: Of 1, s and s² with s = (time − centre) / scale; shape (3,).
        inverse: Inverse of the Gram matrix of this basis; shape (3, 3).
        extent: Difference of the largest and the smallest sample that was used.
        residuals: Of the samples that were used, in their order.
        runs: Number of runs of equal values among them: less than their number where a signal is rounded coarsely.
        outliers: Share of the samples that were left out.
    """

    centre: float
    scale: float
    coefficients: Array
    inverse: Array
    extent: float
    residuals: Array
    runs: int
    outliers: float

    def value(self, time: float) -> float:
        """Value at a time."""
        return float(self._basis(time) @ self.coefficients)

    def rate(self, time: float) -> float:
        """First derivative at a time [1/s]."""
        return float(self._rate_basis(time) @ self.coefficients)

    @property
    def acceleration(self) -> float:
        """Second derivative [1/s²]."""
        return float(2 * self.coefficients[2] / self.scale**2)

    def value_std(self, time: float, noise_std: float) -> float:
        """Standard error of `value`, given the standard deviation of the samples."""
        return self._std(self._basis(time), noise_std)

    def rate_std(self, time: float, noise_std: float) -> float:
        """Standard error of `rate`."""
        return self._std(self._rate_basis(time), noise_std)

    @property
    def top(self) -> float:
        """Time of the maximum; NaN if there is none."""
        _, slope, bend = self.coefficients
        return float(self.centre - self.scale * slope / (2 * bend)) if bend < 0 else float("nan")

    def top_std(self, noise_std: float) -> float:
        """Standard error of `top`, to first order: that of the rate there by the acceleration."""
        return self.rate_std(self.top, noise_std) / abs(self.acceleration)

    def _std(self, basis: Array, noise_std: float) -> float:
        return noise_std * float(np.sqrt(basis @ self.inverse @ basis))

    def _basis(self, time: float) -> Array:
        s = (time - self.centre) / self.scale
        return np.array([1.0, s, s * s])

    def _rate_basis(self, time: float) -> Array:
        return np.array([0.0, 1.0, 2 * (time - self.centre) / self.scale]) / self.scale


def fit_parabola(signal: Signal, centre: float, begin: float, end: float) -> LocalFit | None:
    """Fits the samples from `begin` to `end`; None if they are too few, or do not cover this time.

    Samples far off the parabola, by the median absolute residual, are left out.
    """
    part = signal.between(begin, end)
    width = end - begin
    if len(part) < FEWEST_SAMPLES or part.time[-1] - part.time[0] < 0.7 * width:
        return None
    s = (part.time - centre) / width
    basis = np.stack([np.ones_like(s), s, s * s], axis=-1)
    values = np.asarray(part.values, float)
    used = np.ones(len(s), bool)
    solver = _solver(basis)
    for _ in range(2):
        if solver is None:
            return None
        near = _near(basis, values, solver @ values[used])
        if (near == used).all():
            break
        used = near
        solver = _solver(basis[near])
    if solver is None or used.sum() < FEWEST_SAMPLES:
        return None
    coefficients = solver @ values[used]
    residuals = values[used] - basis[used] @ coefficients
    extent = float(np.ptp(values[used]))
    runs = 1 + int(np.count_nonzero(np.diff(values[used])))
    return LocalFit(centre, width, coefficients, solver @ solver.T, extent, residuals, runs, 1 - float(used.mean()))


def _solver(basis: Array) -> Array | None:
    """The matrix that gives the coefficients of least squares; None if they are not unique."""
    if len(basis) < basis.shape[1]:
        return None
    left, sizes, right = np.linalg.svd(basis, full_matrices=False)
    if sizes[-1] <= sizes[0] * len(basis) * np.finfo(float).eps:
        return None
    return np.asarray(right.T @ (left.T / sizes[:, np.newaxis]), float)


def _near(basis: Array, values: Array, coefficients: Array) -> NDArray[np.bool_]:
    """The samples near a parabola: within `OUTLYING` robust standard deviations."""
    residuals = np.abs(values - basis @ coefficients)
    return residuals <= OUTLYING * 1.4826 * np.median(residuals) + 1e-12 * np.ptp(values)


def noise_std_of(fits: Sequence[LocalFit], resolution: float) -> Array:
    """For each fit, the standard deviation of independent errors that would make it as uncertain as the real ones do.

    The variance of the residuals is multiplied by (1 + ρ) / (1 − ρ), where ρ is the correlation of successive residuals
    (Bartlett's formula for first-order autoregressive errors). Both are the medians of all fits, or those of a single
    fit if its variance is `UNUSUAL`, for example because the sensor repeated a value. Errors of rounding are equal as
    long as the signal hardly changes, so their variance, resolution² / 12, counts once for each run of equal values.

    Args:
        fits: Fits to parts of the signal, at least one.
        resolution: Smallest difference of two values of the signal.
    """
    squares = np.array([fit.residuals @ fit.residuals for fit in fits])
    products = np.array([fit.residuals[1:] @ fit.residuals[:-1] for fit in fits])
    counts = np.array([len(fit.residuals) for fit in fits])
    variances = squares / (counts - 3)
    correlations = products / np.where(squares > 0, squares, 1)
    typical = np.median(variances)
    correlation = np.median(correlations)
    unusual = variances > UNUSUAL * typical
    variances = np.where(unusual, variances, typical)
    correlations = np.clip(np.where(unusual, np.maximum(correlations, correlation), correlation), 0, 0.98)
    rounding = resolution**2 / 12 * counts / np.array([fit.runs for fit in fits])
    return np.sqrt(np.maximum(variances * (1 + correlations) / (1 - correlations), rounding))


def resolution_of(signal: Signal) -> float:
    """Smallest difference of two values, such as the step of an encoder; not less than the rounding of the largest."""
    values = np.unique(np.asarray(signal.values, float))
    return max(float(np.diff(values).min()) if len(values) > 1 else 0.0, rounding_of(values))


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
    signals = [log.signal(coordinate.column) for coordinate in coordinates]
    height = log.signal(settings.height_column) if settings.at_apex else None
    estimator = _Estimator(sections, coordinates, signals, height, one_sided=settings.at != "apex")
    if height is None and all(coordinate.mean for coordinate in coordinates):
        return estimator(np.nan)
    longest = settings.window or _longest_window(sections)
    candidates = [estimator(longest * part) for part in (WINDOW_PARTS[:1] if settings.window else WINDOW_PARTS)]
    usable = [estimate for estimate in candidates if np.isfinite(estimate.state).all(axis=1).sum() > len(sections) / 2]
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
    flights = np.array([section.end - section.begin for section in sections])
    if np.isfinite(flights).all():
        return 0.4 * float(np.median(flights))
    return 0.2 * float(np.median(np.diff([section.time for section in sections])))


def _agree(longer: SectionStates, shorter: SectionStates) -> bool:
    """Whether a longer window gives estimates as good as a shorter one, by `MORE_DOUBTS` and `BIAS`."""
    more = sum(bool(a and not b) for a, b in zip(longer.doubts, shorter.doubts, strict=True))
    if more > MORE_DOUBTS * len(longer.time):
        return False
    sure = np.array([not (a or b) for a, b in zip(longer.doubts, shorter.doubts, strict=True)])
    for i in range(longer.state.shape[1]):
        with np.errstate(divide="ignore", invalid="ignore"):  # of a signal that is constant
            differences = (longer.state - shorter.state)[sure, i] / shorter.std[sure, i]
        ratios = differences[np.isfinite(differences)]
        if len(ratios) and np.sqrt(np.mean(ratios**2)) > BIAS:
            return False
    return True


@final
@dataclass(frozen=True, eq=False)
class _Estimator:
    """Estimates with a given window.

    Attributes:
        signals: Those of the coordinates.
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
        texts = tuple("; ".join(dict.fromkeys(reasons)) for reasons in doubts)
        return SectionStates(times, time_std, state, std, texts, window)

    def _means(
        self, coordinate: SignalCoordinate, signal: Signal, times: Array, doubts: Sequence[list[str]]
    ) -> tuple[Array, Array]:
        """Means over the steps that end at the sections, and their standard errors; notes which are doubtful."""
        since = np.array([section.since for section in self.sections])
        begin = np.where(np.isnan(since), np.append(np.nan, times[:-1]), since)
        values, std, reasons = step_means(signal, begin, times, rate=coordinate.rate)
        for reason, notes in zip(reasons, doubts, strict=True):
            if reason:
                notes.append(f"{reason} of {coordinate.column}")
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
    parabolas = [fit for fit in fits if fit]
    deviations = iter(noise_std_of(parabolas, resolution_of(signal)).tolist() if parabolas else [])
    return [next(deviations) if fit else float("nan") for fit in fits]


def _note_uncertain(state: Array, std: Array, doubts: Sequence[list[str]], name: str) -> None:
    if not np.isfinite(std).any():
        return
    spread = float(np.nanstd(state))
    typical = _usual(std, max(_EXACT * spread, rounding_of(state[np.isfinite(state)])))
    for error, notes in zip(std, doubts, strict=True):
        if error > max(UNCERTAIN * typical, IMPRECISE * spread):
            notes.append(f"the standard error of {name} is {error / typical:.0f} times as large as usual")


def _note_poor_fits(fits: Sequence[LocalFit | None], signal: Signal, doubts: Sequence[list[str]], name: str) -> None:
    """Notes which fits fail or are much worse than a typical one."""
    values = np.asarray(signal.values, float)
    exact = max(_EXACT * float(np.ptp(values)), rounding_of(values))
    sizes = np.array([float(np.sqrt(np.mean(fit.residuals**2))) if fit else np.nan for fit in fits])
    typical = _usual(sizes, exact)
    for fit, size, notes in zip(fits, sizes, doubts, strict=True):
        if fit is None:
            notes.append(f"too few samples for {name}")
        elif fit.outliers > MOST_SAMPLES_OFF:
            notes.append(f"{fit.outliers:.0%} of the samples for {name} are off")
        elif size > max(LARGE_RESIDUALS * typical, SMALL_RESIDUALS * fit.extent, exact):
            notes.append(f"the samples for {name} do not fit a parabola")


def _usual(errors: Array, exact: float) -> float:
    """Median of the errors that are no smaller than what counts as exact; that if there are none."""
    larger = errors[errors > exact]
    return float(np.median(larger)) if len(larger) else exact

"""The mean of a signal, or of its rate, over each step, and the standard error of it."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from stepgap.logs.sections.signals import Signal
from stepgap.step import Array

FEWEST_IN_STEP: Final = 4  # A mean needs at least this number of samples,

LONGEST_GAP_IN_MEAN: Final = 0.45
"""and none of them may be missing for this part of a step: one of five samples may."""

FAR_OFF: Final = (12.0, 0.5)
"""A sample is far off if it differs from the median of five by more than twelve robust standard deviations, and by more
than half of the range of 98 % of all samples."""


def step_means(signal: Signal, begin: Array, end: Array, *, rate: bool) -> tuple[Array, Array, list[str]]:
    """Means between pairs of times, between samples along straight lines.

    Args:
        begin: Times [s]; shape (K,), NaN where there is none.
        end: Times [s]; shape (K,).
        rate: Whether it is the mean of the rate: the difference between both times over the time between them.

    Returns:
        Means and their standard errors, shapes (K,), NaN where there is none; and why it is doubtful, or an empty text.
    """
    time = signal.time
    values = np.asarray(signal.values, float)
    spikes = _far_off(time, values, rate=rate)
    noise = _noise_std(values)
    means = np.full(len(end), np.nan)
    std = np.full(len(end), np.nan)
    doubts = [""] * len(end)
    for number, (first, last) in enumerate(zip(begin.tolist(), end.tolist(), strict=True)):
        # The samples of a step, and the longest time without one.
        inside = slice(*np.searchsorted(time, [first, last]).tolist())
        gap = np.diff([first, *time[inside].tolist(), last]).max() if np.isfinite(first) else 0.0
        count = inside.stop - inside.start
        if not time[0] <= first <= last <= time[-1]:
            continue
        if count < FEWEST_IN_STEP or gap > LONGEST_GAP_IN_MEAN * (last - first):
            doubts[number] = "too few samples"
        elif spikes[inside.start : inside.stop + 1].any():
            doubts[number] = "a sample is far off"
        # The mean of the rate by both ends, of the signal by the area below it.
        ends = np.interp([first, last], time, values)
        if rate:
            means[number] = (ends[1] - ends[0]) / (last - first)
            std[number] = np.sqrt(2) * noise / (last - first)
        else:
            knots = np.array([first, *time[inside].tolist(), last])
            samples = np.array([ends[0], *values[inside].tolist(), ends[1]])
            means[number] = np.trapezoid(samples, knots) / (last - first)
            std[number] = noise / np.sqrt(max(count, 1))
    return means, std, doubts


def _noise_std(values: Array) -> float:
    """Standard deviation of independent errors of the samples: by their second differences, of which most are noise."""
    second = np.diff(values, 2)
    return float(1.4826 * np.median(np.abs(second)) / np.sqrt(6)) if len(second) else np.nan


def _far_off(time: Array, values: Array, *, rate: bool) -> NDArray[np.bool_]:
    """Whether each sample, or the change that leads to it, is far off; shape (R,)."""
    if rate:
        intervals = np.diff(time)
        values = np.append(0.0, np.diff(values) / np.maximum(intervals, np.median(intervals) or 1e-9))
    around = np.lib.stride_tricks.sliding_window_view(np.pad(values, 2, "edge"), 5)
    away = np.abs(values - np.median(around, axis=1))
    usual = np.ptp(np.quantile(values, [0.01, 0.99]))
    return away > max(FAR_OFF[0] * 1.4826 * float(np.median(away)), FAR_OFF[1] * float(usual), 1e-12)

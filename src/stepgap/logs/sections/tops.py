"""The tops of a signal: one for each hop, although the signal is noisy, rounded or interrupted."""

from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from stepgap.logs.sections.signals import Signal
from stepgap.records.steps_csv import RecordError
from stepgap.step import Array

_Indices = NDArray[np.intp]
"""Numbers of samples."""

CLEAR: Final = 3.0
"""The least prominent top of a hop must be more prominent than any other maximum by this factor."""

SMALL: Final = 0.15  # Other maxima must be less prominent than this part of the median top of a hop

SHALLOW: Final = 0.2  # The least descent of a hop, in parts of a typical descent after an apex
TALL: Final = 0.5  # A top between two apexes that is another hop, in the same parts

MOST_INTERPOLATED: Final = 2**22  # A signal is interpolated at no more times than this


def tops(signal: Signal, rise: float = 0.0) -> list[float]:
    """Times of the tops of all hops.

    The signal is smoothed more and more, from one sample on, until its maxima fall into two groups by prominence: those
    of hops, and others that are at least `CLEAR` times less prominent; and until twice the smoothing gives the same
    hops. Of equal maxima, which rounded signals have, the last one counts.

    Args:
        rise: Smallest prominence of the top of a hop, in the unit of the signal; 0 to find it.

    Raises:
        RecordError: There are no two groups.
    """
    from scipy.ndimage import gaussian_filter1d, median_filter

    time, values = _uniform(signal)
    values = median_filter(values, 5)  # a single wrong sample is no top
    former: _Indices | None = None
    width = 1.0
    while width < len(values) / 20:
        peaks = _prominent(gaussian_filter1d(values, width), rise)
        apart = 4 * width
        if former is not None and peaks is not None and _same(former, peaks, apart):
            spacing = float(np.median(np.diff(peaks))) if len(peaks) > 1 else np.inf
            if width <= 0.15 * spacing:
                return time[peaks].tolist()
        former = peaks
        width = 2 * width
    advice = "lower" if rise else "give"
    raise RecordError(
        f"no clear difference between the tops of hops and other maxima; {advice} --rise, the smallest rise of a hop, "
        "or name a column of the phase, the contact or the force"
    )


def hop_faults(height: Signal, apexes: Array) -> list[str]:
    """Why the motion from one apex to the next is not a single hop; empty texts where it is.

    Between its apexes, a hop descends by at least `SHALLOW` of a typical descent, and has no other top with `TALL` of
    it.

    Args:
        apexes: Times of the K apexes [s]; shape (K,).
    """
    from scipy.ndimage import median_filter
    from scipy.signal import find_peaks

    parts = [
        median_filter(np.asarray(height.between(begin, end).values, float), 5)
        for begin, end in pairwise(apexes.tolist())
    ]
    descents = np.array([min(part[0], part[-1]) - part.min() if len(part) else np.nan for part in parts])
    if not np.isfinite(descents).any():
        return ["no height"] * len(parts)
    typical = float(np.nanmedian(descents))
    faults: list[str] = []
    for descent, part in zip(descents, parts, strict=True):
        if not descent >= SHALLOW * typical:
            faults.append("the height hardly descends between its sections")
        elif len(find_peaks(part, prominence=TALL * typical)[0]):
            faults.append("another top between its sections")
        else:
            faults.append("")
    return faults


def _uniform(signal: Signal) -> tuple[Array, Array]:
    """Times at equal intervals, and the values there, interpolated linearly."""
    step = max(signal.interval, 1e-9)
    duration = float(signal.time[-1] - signal.time[0])
    if duration / step > MOST_INTERPOLATED:
        raise RecordError(f"{duration / step:.3g} samples; at most {MOST_INTERPOLATED} are searched for tops")
    time = signal.time[0] + step * np.arange(int(duration / step) + 1)
    return time, np.interp(time, signal.time, np.asarray(signal.values, float))


def _prominent(values: Array, rise: float) -> _Indices | None:
    """Indices of the maxima of the more prominent group; None if there are no two groups."""
    from scipy.signal import find_peaks, peak_prominences

    strictly = values + np.arange(len(values)) * 1e-12 * (np.ptp(values) or 1.0)  # of equal maxima the last is higher
    peaks = find_peaks(strictly)[0]
    prominences = peak_prominences(strictly, peaks)[0]
    if rise:
        return peaks[prominences >= rise]
    order = np.sort(prominences)[::-1]
    if len(order) < 2:
        return None
    # One maximum may stand out by far, such as that of lifting the robot, so the group has at least two.
    others = np.maximum(np.append(order[2:], 0.0), _floor(values))
    medians = order[(np.arange(len(others)) + 1) // 2]
    clear = np.flatnonzero((order[1:] >= CLEAR * others) & (others <= SMALL * medians))
    return peaks[prominences >= order[clear[0] + 1]] if len(clear) else None


def _floor(values: Array) -> float:
    """Prominence that a maximum of mere noise may have: some standard deviations of the second differences."""
    return float(4 * np.std(np.diff(values, 2)) + 1e-9 * np.ptp(values))


def _same(former: _Indices, peaks: _Indices, apart: float) -> bool:
    return len(former) == len(peaks) and bool((np.abs(former - peaks) <= apart).all())

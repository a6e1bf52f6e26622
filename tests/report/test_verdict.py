"""What is called smaller or larger is so about as often as it is said."""

import numpy as np
import pytest

from stepgap.experiment.bands import rms_interval
from stepgap.report.verdict import clear_change
from stepgap.step import Array


def judged(before: Array, after: Array) -> float:
    """Change from errors (N,) to others."""
    ends = np.array([rms_interval(errors[:, None])[:, 0] for errors in (before, after)])
    first, last = (float(np.sqrt(np.mean(errors**2))) for errors in (before, after))
    return clear_change(first, last, ends)


@pytest.mark.parametrize("count", [30, 227])
def test_noise_is_rarely_called_a_change_and_a_change_is_found(count: int) -> None:
    rng = np.random.default_rng(0)
    draws = rng.normal(size=(200, 2, count))
    assert np.mean([judged(*draw) != 0 for draw in draws]) < 0.12
    assert np.mean([judged(2.5 * draw[0], draw[1]) == -1 for draw in draws]) > 0.95
    assert np.mean([judged(draw[0], 2.5 * draw[1]) == 1 for draw in draws]) > 0.95


def test_without_intervals_equal_errors_are_those_of_nearly_the_same_size() -> None:
    unknown = np.full((2, 2), np.nan)
    assert [clear_change(1.0, after, unknown) for after in (0.9, 0.97, 1.0, 1.03, 1.1)] == [-1, 0, 0, 0, 1]

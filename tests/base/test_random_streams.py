"""Random streams with different keys are independent."""

from itertools import combinations

import numpy as np

from stepgap.base.random_streams import random_stream

KEYS = [(), (0,), (1,), (0, 0), (0, 1), (1, 0), (0, 0, 0), (1, 0, 0)]


def test_zeros_at_the_end_of_a_key_count() -> None:
    drawn = [random_stream(seed, *key).integers(2**63, size=4) for seed in (0, 1, 2**40) for key in KEYS]
    assert all(not np.array_equal(first, second) for first, second in combinations(drawn, 2))


def test_the_same_key_gives_the_same_stream() -> None:
    np.testing.assert_array_equal(random_stream(3, 1).random(5), random_stream(3, 1).random(5))

"""Random numbers for one purpose each."""

import numpy as np


def random_stream(seed: int, *key: int) -> np.random.Generator:
    """A generator that has nothing in common with those of other keys, the empty one included.

    A plain `default_rng([seed, key])` would, where the key is zero: NumPy fills lists up with zeros.

    Args:
        seed: Of a whole experiment; not negative.
        key: For what it is, such as the number of a deployment; not negative.
    """
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))

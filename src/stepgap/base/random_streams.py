"""Independent streams of random numbers, one for each purpose."""

import numpy as np


def random_stream(seed: int, *key: int) -> np.random.Generator:
    """Returns a random generator that is independent of those with other keys, including the empty key.

    `default_rng([seed, key])` would not be: NumPy pads lists with zeros, so the key 0 equals the empty key.

    Args:
        seed: Random seed of the experiment; not negative.
        key: Identifies the purpose, such as the number of a deployment; not negative.
    """
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))

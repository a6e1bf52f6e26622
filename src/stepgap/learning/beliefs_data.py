"""Beliefs as JSON-ready data, for files."""

from collections.abc import Mapping
from typing import Any, Final, get_args

import numpy as np

from stepgap.base.json_data import LARGEST_NUMBER, as_object, integer, number, numbers
from stepgap.base.ranges import require
from stepgap.gauss.features import Features
from stepgap.gauss.weights import Weights
from stepgap.learning.belief import Belief, Kind
from stepgap.learning.beliefs import MOST, Beliefs
from stepgap.learning.posterior import features_from_dict, features_to_dict
from stepgap.step import Array

MOST_READ: Final = 10 * MOST
"""Largest number of beliefs that is read: warm starts have one for each earlier run."""
LEAST: Final = 1e-12
"""Smallest deviation, and sum of squares, that is read: products of smaller ones could be zero."""


def beliefs_to_dict(beliefs: Beliefs) -> dict[str, Any]:
    """Converts beliefs before the first step of a deployment to data, which `beliefs_from_dict` reads."""
    return {
        "features": features_to_dict(beliefs.features),
        "change": [_lower(matrix) for matrix in np.linalg.cholesky(beliefs.change)],
        "wrong_measurements": list(beliefs.wrong_measurements),
        "beliefs": [
            {
                "kind": belief.kind,
                "mean": belief.weights.mean.tolist(),
                "root": [_lower(root) for root in belief.weights.root],
                "freedom": belief.freedom.tolist(),
                "squares": belief.squares.tolist(),
                "log_weight": belief.log_weight,
                "rate": belief.rate,
                "age": belief.age,
            }
            for belief in beliefs.beliefs
        ],
    }


def beliefs_from_dict(saved: Mapping[str, Any], sizes: tuple[int, int]) -> Beliefs:
    """Restores beliefs; a ValueError names the wrong key.

    Args:
        saved: What `beliefs_to_dict` made.
        sizes: Number of state coordinates n and of command coordinates m.
    """
    n, m = sizes
    features = features_from_dict(as_object(saved.get("features"), "beliefs.features"))
    size = features.count + 2 + n + m
    root = _roots(saved, "change", n, size)
    counts = numbers(saved, "wrong_measurements", 1)
    require(counts.shape == (2,) and bool((counts > 0).all()), "wrong_measurements", counts, "be two positive numbers")
    entries = saved.get("beliefs")
    if not isinstance(entries, list) or not 0 < len(entries) <= MOST_READ:
        raise ValueError(f"beliefs must be a list of 1 to {MOST_READ}")
    restored = tuple(_belief_from(as_object(entry, "beliefs"), n, size, features) for entry in entries)
    if all(belief.kind == "earlier" for belief in restored):
        raise ValueError("beliefs: kind must be another one than earlier at least once")
    change = root @ np.swapaxes(root, 1, 2)
    return Beliefs(features, restored, change, np.zeros(n + m), None, (counts[0], counts[1]), np.empty((0, size)))


def _belief_from(saved: Mapping[str, Any], n: int, size: int, features: Features) -> Belief:
    kinds: dict[str, Kind] = {name: name for name in get_args(Kind)}
    if (kind := kinds.get(str(saved.get("kind")))) is None:
        raise ValueError(f"beliefs: kind must be one of {', '.join(kinds)}, not {saved.get('kind')!r:.40}")
    mean = numbers(saved, "mean", 2)
    freedom = numbers(saved, "freedom", 1)
    squares = numbers(saved, "squares", 1)
    require(mean.shape == (n, size), "beliefs: mean.shape", mean.shape, f"be {(n, size)} with these {features.count}")
    _check_size(mean, "mean")
    for name, values, least in (("freedom", freedom, 2.0), ("squares", squares, LEAST)):
        require(values.shape == (n,) and bool((values > least).all()), f"beliefs: {name}", values, f"exceed {least:g}")
        _check_size(values, name)
    rate = number(saved, "rate")
    age = integer(saved, "age", 0)
    require(0 <= rate <= 1, "beliefs: rate", rate, "lie between 0 and 1")
    weights = Weights(mean, _roots(saved, "root", n, size))
    return Belief(kind, weights, freedom, squares, number(saved, "log_weight"), rate, age)


def _lower(matrix: Array) -> list[float]:
    """The numbers of a lower triangular matrix, row by row, without the zeros."""
    return matrix[np.tril_indices(len(matrix))].tolist()


def _roots(saved: Mapping[str, Any], key: str, n: int, size: int) -> Array:
    """Lower triangular matrices whose diagonal is positive; shape (n, k, k)."""
    rows = numbers(saved, key, 2)
    expected = (n, size * (size + 1) // 2)
    require(rows.shape == expected, f"beliefs: {key}.shape", rows.shape, f"be {expected}")
    roots = np.zeros((n, size, size))
    roots[:, *np.tril_indices(size)] = rows
    diagonal = roots[:, range(size), range(size)]
    least = float(diagonal.min())
    require(least > LEAST, f"beliefs: {key}", least, f"have no number on its diagonal that is less than {LEAST:g}")
    _check_size(rows, key)
    return roots


def _check_size(values: Array, key: str) -> None:
    """Raises ValueError if a number is so large that the product of such numbers is none."""
    largest = float(np.abs(values).max(initial=0.0))
    require(largest <= LARGEST_NUMBER, f"beliefs: {key}", largest, f"have no number beyond ±{LARGEST_NUMBER:g}")

"""Readers of values from JSON data; an error names the key and states what is valid."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

_DESCRIPTIONS = ("a number", "a list of numbers", "a list of equally long lists of numbers")


def numbers(data: Mapping[str, Any], key: str, dimensions: int) -> NDArray[np.float64]:
    """The array of finite numbers under `key`.

    Raises:
        ValueError: The key is missing, or its value is of another kind.
    """
    try:
        array = np.asarray(data[key])
    except KeyError:
        raise ValueError(f"{key} must be {_DESCRIPTIONS[dimensions]}, but it is missing") from None
    except ValueError:
        array = np.array("ragged")
    if array.dtype.kind not in "if" or array.ndim != dimensions or not np.isfinite(array).all():
        raise ValueError(f"{key} must be {_DESCRIPTIONS[dimensions]}, all finite")
    return array.astype(float)


def number(data: Mapping[str, Any], key: str) -> float:
    """The finite number under `key`.

    Raises:
        ValueError: The key is missing, or its value is of another kind.
    """
    return float(numbers(data, key, 0))


def integer(data: Mapping[str, Any], key: str, least: int = 1) -> int:
    """The integer under `key`.

    Raises:
        ValueError: The key is missing, or its value is of another kind or less than `least`.
    """
    value = data.get(key)
    if not isinstance(value, int) or isinstance(value, bool) or value < least:
        raise ValueError(f"{key} must be an integer of at least {least}, not {value!r:.40}")
    return value


def boolean(data: Mapping[str, Any], key: str) -> bool:
    """The boolean under `key`.

    Raises:
        ValueError: The key is missing, or its value is of another kind.
    """
    if not isinstance(data.get(key), bool):
        raise ValueError(f"{key} must be true or false, not {data.get(key)!r:.40}")
    return data[key]

"""Reading of JSON data with checks; an error names the key and states what is valid."""

import json
from collections.abc import Mapping
from typing import Any, NoReturn, cast

import numpy as np
from numpy.typing import NDArray

from stepgap.base.ranges import format_value

LARGEST_NUMBER = 1e9  # Largest magnitude of a number that is accepted as a measurement [SI units]

_DESCRIPTIONS = ("a number", "a list of numbers", "a list of equally long lists of numbers")


def parse_json(text: str) -> Any:
    """Parses JSON, which has neither NaN nor infinity.

    Raises:
        ValueError: It is not JSON, or it is nested too deeply.
    """
    try:
        return json.loads(text, parse_constant=_refuse)
    except RecursionError:
        raise ValueError("its lists or objects are nested too deeply") from None


def _refuse(constant: str) -> NoReturn:
    raise ValueError(f"{constant} is not a JSON number")


def is_measurement(value: Any) -> bool:
    """Whether a value is a number within ±`LARGEST_NUMBER`; a boolean is none."""
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= LARGEST_NUMBER


def describe_value(value: Any) -> str:
    """Formats a value for a message; one that is null counts as missing."""
    return "missing" if value is None else format_value(value)


def check_value(condition: object, name: str, value: Any, rule: str) -> None:
    """Raises ValueError `name is VALUE, but it must RULE` unless the condition holds; for data in a file."""
    if not condition:
        raise ValueError(f"{name} is {describe_value(value)}, but it must {rule}")


def as_object(value: Any, name: str) -> dict[str, Any]:
    """The value, which must be an object; `name` is that of the value in the message.

    Raises:
        ValueError: It is of another kind.
    """
    check_value(isinstance(value, dict), name, value, "be an object, {…}")
    return value


def objects(data: Mapping[str, Any], key: str, of: str, where: str = "") -> list[dict[str, Any]]:
    """The list of objects under `key`; the message says `of` what it must be, and begins with `where`.

    Raises:
        ValueError: The key is missing, or its value is of another kind.
    """
    values = data.get(key)
    check_value(isinstance(values, list), f"{where}{key}", values, f"be a list of {of}")
    return [as_object(item, f"{where}{key}[{row}]") for row, item in enumerate(values or ())]


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


def integer(data: Mapping[str, Any], key: str, least: int = 1, where: str = "") -> int:
    """The integer under `key`.

    Args:
        least: Smallest valid integer.
        where: What the message begins with, such as the name of the file and a colon.

    Raises:
        ValueError: The key is missing, or its value is of another kind, less than `least`, or not of 64 bits.
    """
    value = data.get(key)
    valid = isinstance(value, int) and not isinstance(value, bool) and least <= value < 2**63
    check_value(valid, f"{where}{key}", value, f"be an integer from {least}")
    return cast("int", value)


def boolean(data: Mapping[str, Any], key: str) -> bool:
    """The boolean under `key`.

    Raises:
        ValueError: The key is missing, or its value is of another kind.
    """
    value = data.get(key)
    check_value(isinstance(value, bool), key, value, "be true or false")
    return cast("bool", value)

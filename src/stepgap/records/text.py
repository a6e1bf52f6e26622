"""Numbers, units and intervals as text, for sentences, tables and figures."""

from collections.abc import Iterable, Sequence

import numpy as np

from stepgap.base.errors import InputError
from stepgap.step import Array, Quantity

LONGEST_NUMBER = 14  # Largest number of characters of a number with the decimals of its coordinate


def decimal(value: float, digits: int = 3) -> str:
    """Number with a few significant digits, without exponent where possible; a dash for NaN."""
    if not np.isfinite(value):
        return "–"
    if value == 0:
        return "0"
    if 1e-6 < abs(value) < 1e6:
        decimals = digits - 1 - int(np.floor(np.log10(abs(value))))
        return f"{value:.{max(decimals, 0)}f}".replace("-", "−")
    return f"{value:.{digits}g}".replace("-", "−")


def in_scale(value: float, quantity: Quantity, digits: int = 4) -> str:
    """Number with the decimals of its coordinate, of which half the range of use has some digits; a dash for NaN.

    So a number far from zero in a narrow range keeps its digits, and a small one is not rounded to zero because of its
    unit. If the range is not known, the number itself has these digits.
    """
    if not np.isfinite(value) or not _has_range(quantity):
        return decimal(value, digits)
    decimals = decimals_of(quantity, digits)
    text = f"{value:.{decimals}f}"
    if float(text) == 0:
        return f"{0:.{decimals}f}"
    return (text if len(text) <= LONGEST_NUMBER else f"{value:.{digits}g}").replace("-", "−")


def decimals_of(quantity: Quantity, digits: int = 4) -> int:
    """Number of decimals with which half the range of use of a coordinate has some digits."""
    return max(digits - 1 - int(np.floor(np.log10((quantity.upper - quantity.lower) / 2))), 0)


def in_words(quantities: Sequence[Quantity], values: Iterable[float]) -> str:
    """Coordinates with their names, values and units, such as "speed 0.3 m/s, height 0.7 m"; NaN is left out."""
    pairs = [(one, value) for one, value in zip(quantities, values, strict=True) if value == value]
    return ", ".join(f"{one.name} {trimmed(in_scale(value, one))}{unit_suffix(one)}" for one, value in pairs)


def values_by_name(
    option: str, text: str | None, quantities: Sequence[Quantity], defaults: Iterable[float]
) -> list[float]:
    """Values of quantities from text such as `speed=0.2,height=0.58`; those that are not named have their default.

    Raises:
        InputError: A name or a number is wrong.
    """
    values = {quantity.name: float(value) for quantity, value in zip(quantities, defaults, strict=True)}
    given = set[str]()
    for part in text.split(",") if text else ():
        name, _, number = part.partition("=")
        if name not in values:
            raise InputError(f"{option} {text}: no name {name!r}; it must be of {', '.join(values)}")
        try:
            value = float(number)
        except ValueError:
            value = np.nan
        if name in given or not np.isfinite(value):
            example = ",".join(f"{one.name}={(one.lower + one.upper) / 2:g}" for one in quantities)
            raise InputError(f"{option} {text}: it must be names, each once, with finite numbers, such as {example}")
        values[name] = value
        given.add(name)
    return list(values.values())


def trimmed(number: str) -> str:
    """Text of a number without the zeros at its end that say nothing but its resolution."""
    return number.rstrip("0").rstrip(".") if "." in number and "e" not in number else number


def listed(parts: Sequence[str], last: str = "and") -> str:
    """An enumeration: "speed", "speed and height", "speed, height and pitch"."""
    return f" {last} ".join([*([", ".join(parts[:-1])] if len(parts) > 1 else []), *parts[-1:]])


def _has_range(quantity: Quantity) -> bool:
    """Whether the range of a coordinate is known; that of a file without a robot is a placeholder."""
    return bool(quantity.unit) or (quantity.lower, quantity.upper) != (-1, 1)


def between(ends: Array, unit: str = "", digits: int = 3) -> str:
    """Text of a 95 % interval after the value it belongs to; empty where it is not known."""
    if not np.isfinite(ends).all():
        return ""
    return f" (95 % interval {decimal(ends[0], digits)} to {decimal(ends[1], digits)}{unit})"


def with_unit(quantity: Quantity) -> str:
    """Name and unit of a coordinate, as in tables."""
    return f"{quantity.name} [{quantity.unit}]" if quantity.unit else quantity.name


def unit_suffix(quantity: Quantity) -> str:
    """The unit as it follows a number in a sentence: after a blank, or empty if there is none."""
    return f" {quantity.unit}" if quantity.unit else ""


def capitalised(text: str) -> str:
    """The text as the beginning of a sentence."""
    return text[:1].upper() + text[1:]

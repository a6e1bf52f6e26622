"""Numbers, units and intervals as text, for sentences, tables and figures."""

import numpy as np

from stepgap.step import Array, Quantity


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

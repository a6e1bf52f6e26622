"""Quantities and numbers with their units, as text."""

from stepgap.step import Quantity


def with_unit(quantity: Quantity) -> str:
    """Name and unit of a coordinate, as in tables."""
    return f"{quantity.name} [{quantity.unit}]" if quantity.unit else quantity.name


def unit_suffix(quantity: Quantity) -> str:
    """The unit as it follows a number in a sentence: after a blank, or empty if there is none."""
    return f" {quantity.unit}" if quantity.unit else ""

"""Numbers have the digits of their coordinate's range, whatever its unit, and zero has no sign."""

import numpy as np
import pytest

from stepgap.records.text import in_scale, in_words, listed, trimmed
from stepgap.step import Quantity

SPEED, FOOT = Quantity("speed", "m/s", 0.0, 0.4), Quantity("foot_x", "rad", -0.004, 0.004)


@pytest.mark.parametrize(
    ("quantity", "value", "text"),
    [
        (SPEED, 0.2255, "0.2255"),
        (SPEED, -1e-9, "0.0000"),
        (FOOT, -0.00003, "−0.000030"),
        (FOOT, -3e-8, "0.000000"),
        (Quantity("position", "m", 1000.0, 1000.001), 1000.0004567, "1000.0004567"),
        (Quantity("force", "N", -30_000.0, 30_000.0), -12_345.6, "−12346"),
        (Quantity("unknown", "", -1.0, 1.0), 0.000123456, "0.0001235"),
        (Quantity("unknown", "", -1.0, 1.0), 12_345.6, "12346"),
        (SPEED, np.nan, "–"),
    ],
)
def test_digits_are_those_of_the_range(quantity: Quantity, value: float, text: str) -> None:
    assert in_scale(value, quantity) == text


def test_coordinates_are_named_and_lists_have_commas() -> None:
    assert in_words((SPEED, FOOT), (0.3, -0.001)) == "speed 0.3 m/s, foot_x −0.001 rad"
    assert [trimmed(text) for text in ("0.2500", "10.0", "100", "1.50e10")] == ["0.25", "10", "100", "1.50e10"]
    assert [listed(["a", "b", "c"][:count]) for count in range(4)] == ["", "a", "a and b", "a, b and c"]
    assert listed(["a", "b", "c"], "or") == "a, b or c"

"""Checks of JSON data: what is accepted, and messages that name the key."""

import re

import pytest

from stepgap.base.json_data import LARGEST_NUMBER, as_object, boolean, integer, is_measurement, number, parse_json


@pytest.mark.parametrize("value", [0, -1.5, LARGEST_NUMBER, -LARGEST_NUMBER])
def test_a_measurement_is_a_number_within_the_limit(value: float) -> None:
    assert is_measurement(value)


@pytest.mark.parametrize("value", [True, None, "1", [1], 1.001 * LARGEST_NUMBER, 10**400, float("nan"), float("inf")])
def test_anything_else_is_no_measurement(value: object) -> None:
    assert not is_measurement(value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "Expecting property name"),
        ('{"x": NaN}', "NaN is not a JSON number"),
        ("[-Infinity]", "-Infinity is not a JSON number"),
        ("[" * 100_000, "its lists or objects are nested too deeply"),
    ],
)
def test_text_that_is_not_json_is_refused(text: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        parse_json(text)


def test_messages_name_the_key_its_value_and_the_rule() -> None:
    data = {"steps": True, "used": 1, "size": "x" * 99}
    for read, message in (
        (
            lambda: integer(data, "steps", 0, "summary.json: "),
            "summary.json: steps is true, but it must be an integer from 0",
        ),
        (lambda: integer(data, "seed"), "seed is missing, but it must be an integer from 1"),
        (lambda: integer({"seed": 2**63}, "seed"), f"seed is {2**63}, but it must be an integer from 1"),
        (lambda: boolean(data, "used"), "used is 1, but it must be true or false"),
        (lambda: number(data, "noise"), "noise must be a number, but it is missing"),
        (
            lambda: as_object(data["size"], "a.json: size"),
            f"a.json: size is '{'x' * 59}…, but it must be an object, {{…}}",
        ),
    ):
        with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
            read()

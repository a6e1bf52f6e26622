"""YAML of trainings: numbers with exponents are numbers, and nothing in a file is called."""

import pytest

from stepgap.mujoco_robots.velocity.policy.yaml_text import parse_yaml


def test_numbers_with_exponents_are_numbers() -> None:
    assert parse_yaml("a: [2e-2, -1E3, 1.5e+2, .5]\nb: 2e-2m\n") == {"a": [0.02, -1000.0, 150.0, 0.5], "b": "2e-2m"}


def test_tags_are_passed_over_and_nothing_is_called() -> None:
    text = "a: !!python/object/apply:os.system ['touch gone']\nb: !!python/tuple\n- 1\nc: !x {y: 2}\nd: !z word\n"
    assert parse_yaml(text) == {"a": ["touch gone"], "b": [1], "c": {"y": 2}, "d": "word"}
    assert parse_yaml("") is None


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("a: [1, 2", "expected ',' or ']'"),
        ("a: 1\n  b: 2\n", "mapping values are not allowed here"),
        ("[" * 100_000, "nested too deeply"),
        ("a: 2020-13-45\n", "month must be in 1..12"),
    ],
)
def test_what_it_is_not_is_said_in_a_line(text: str, words: str) -> None:
    with pytest.raises(ValueError, match=words) as refusal:
        parse_yaml(text)
    assert "\n" not in str(refusal.value)

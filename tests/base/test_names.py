"""Names and units can be written into any language; other texts become names, or are refused."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from stepgap.base.names import as_name, is_name, is_unit

HOSTILE = (
    '"""',
    "'''",
    "*/",
    "/*",
    "//",
    "*\\\n/",
    "??/",
    "]]>",
    "</script>",
    "-->",
    "a\nb",
    "a\x00b",
    "a\x1bb",
    "a\u2028b",
    "\ud800",
    "$x$",
    "`x`",
    "{x}",
    "a;b",
    "a#b",
    "a|b",
    'a"b',
    "a'b",
    "a&b",
    "a\\b",
    "=1",
    "+1",
    "@x",
    "-x",
)
"""Parts of texts that end a comment, a string, an element or a cell in some language, or begin a formula."""


@pytest.mark.parametrize("part", HOSTILE)
def test_a_part_with_a_meaning_is_in_no_name_and_in_no_unit(part: str) -> None:
    for text in (part, f"m{part}", f"m{part}s"):
        assert not is_name(text)
        assert is_name(as_name(text))
    assert not is_unit(part)
    assert not is_unit(f"m{part}s") or part in ("+1", "-x"), "signs are those of exponents"


@pytest.mark.parametrize(
    "unit", ["", "m", "m/s", "m/s^2", "N·m/rad", "kg m² s⁻¹", "kg*m**2", "1/min", "°", "%", "µm", "√Hz", "half ranges"]
)
def test_units_of_measurements_are_units(unit: str) -> None:
    assert is_unit(unit)


@given(st.text(max_size=30))
def test_every_text_becomes_a_name_that_stays_as_it_is(text: str) -> None:
    name = as_name(text)
    assert is_name(name)
    assert as_name(name) == name


def test_columns_keep_what_tells_them_apart() -> None:
    texts = ["hip [rad]", "q[0]", "observation.state[3]", "2nd", "()", "größe", "lambda", "v_"]
    wanted = ["hip_rad", "q_0", "observation_state_3", "_2nd", "_", "größe", "lambda", "v_"]
    assert [as_name(text) for text in texts] == wanted

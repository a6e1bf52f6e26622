"""Settings of sections: from a file and options, each wrong one refused by one line that names it."""

import json
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stepgap.base.errors import StepGapError
from stepgap.logs.sections.section_settings import SectionSettings, SignalCoordinate, read_section_settings

KEYS = sorted(SectionSettings.__dataclass_fields__)
VALUES = st.one_of(
    st.text(max_size=9), st.floats(), st.integers(), st.booleans(), st.lists(st.text(max_size=5), max_size=3)
)


@pytest.mark.parametrize(
    ("entry", "expected"),
    [
        ("y", ("y", "y", False, False)),
        ("height=y", ("height", "y", False, False)),
        ("speed=rate(x)", ("speed", "x", True, False)),
        ("rate(x)", ("x", "x", True, False)),
        ("a=b=c", ("a_b", "c", False, False)),
        ("vx=mean(twist.linear.x)", ("vx", "twist.linear.x", False, True)),
        ("vx=mean(rate(x))", ("vx", "x", True, True)),
        ("mean(x)", ("x", "x", False, True)),
    ],
)
def test_coordinates(entry: str, expected: tuple[str, str, bool, bool]) -> None:
    assert SignalCoordinate.of(entry) == SignalCoordinate(*expected)


def test_options_override_the_file(tmp_path: Path) -> None:
    file = tmp_path / "columns.toml"
    file.write_text('height = "y"\nstate = ["y"]\nphase = "p"\nrise = 1\n[factors]\ny = 2\n[format]\ndecimal = ","\n')
    found = read_section_settings(file, {"state": ("v=rate(x)", "y"), "force": ("left", "right"), "rise": 0.5})
    assert (found.state, found.force, found.rise) == (("v=rate(x)", "y"), ("left", "right"), 0.5)
    assert (found.rule, found.phase) == ("force", "")  # another rule replaces that of the file
    assert (found.factors, found.format.decimal) == ({"y": 2}, ",")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({}, "--height = '', but it must be the column of the height, or a boom's pitch, for an apex"),
        ({"height": "y"}, "--state = '', but it must name the state, such as speed=rate(x),height=y"),
        ({"phase": "p", "force": ("f",)}, "--force = 'f', but it must not be given beside phase"),
        (
            {"contact": ("left",), "at": "next_foot", "state": ("x",)},
            "--at = 'next_foot', but it must be given with the contact or the force of at least two feet",
        ),
        ({"boom": 1.2}, "--boom = 1.2, but it must be given together with pitch and yaw"),
        ({"rise": -1.0}, "--rise = -1.0, but it must be a positive number, or 0"),
        ({"every": -0.5}, "--every = -0.5, but it must be a positive number, or 0"),
        ({"every": 0.5, "crossing": "x"}, "--every = '0.5', but it must not be given beside crossing"),
        ({"every": 0.5, "state": ("y",), "delay": float("inf")}, "--delay = inf, but it must be a number of seconds"),
        ({"window": float("nan")}, "--window = nan, but it must be a number"),
        ({"height": "y", "state": ("y", "y")}, "--state = 'y,y', but it must be at most 100 coordinates"),
        (
            {"height": "y", "state": ("x", "y"), "target": ("z",)},
            "--target = 'z', but it must be 2 coordinates, as the state",
        ),
        ({"height": "y", "state": ("y",), "plan_match": "x"}, "--plan-match = 'x', but it must be PLAN_COLUMN=COLUMN"),
    ],
)
def test_wrong_options(options: dict[str, Any], message: str) -> None:
    with pytest.raises(StepGapError) as refusal:
        read_section_settings(None, options)
    assert str(refusal.value).startswith(message)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('heigt = "y"\n', "columns.toml: heigt: unknown key; did you mean height?"),
        ('height = "y"\nstate = "y"\n', "columns.toml: state = 'y', but it must be a list of strings"),
        ('height = "y"\nstate = ["y"]\n[factors]\ny = "m"\n', "columns.toml: factors.y = 'm', but it must be a number"),
        (
            'height = "y"\nstate = ["y"]\n[factors]\ny = 0\n',
            "columns.toml: factors.y = 0.0, but its magnitude must lie",
        ),
        ('height = "y"\nstate = ["y"]\n[units]\ny = 1\n', "columns.toml: units.y = 1, but it must be a string"),
        (
            'height = "y"\nstate = ["y"]\n[format]\ndecimal = "x"\n',
            "columns.toml: format.decimal = 'x', but it must be",
        ),
    ],
)
def test_wrong_files(text: str, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("columns.toml").write_text(text)
    with pytest.raises(StepGapError) as refusal:
        read_section_settings(Path("columns.toml"), {})
    assert message in str(refusal.value)
    assert "\n" not in str(refusal.value)


@settings(max_examples=150)
@given(table=st.dictionaries(st.sampled_from(KEYS), VALUES, max_size=6))
def test_any_table_is_read_or_refused(table: dict[str, object]) -> None:
    lines = [
        f"{key} = {json.dumps(value) if not isinstance(value, float) else repr(value)}" for key, value in table.items()
    ]
    with TemporaryDirectory() as folder:
        file = Path(folder) / "columns.toml"
        file.write_text("\n".join(lines), "utf-8")
        try:
            found = read_section_settings(file, {})
        except StepGapError as refusal:
            assert str(file) in str(refusal)  # noqa: PT017  (both ends are valid)
            return
    assert found.state
    assert found.height_column or found.crossing or found.at != "apex"

"""Reading any CSV log: all numbers are read, rows are chained correctly, and messages name each fault."""

import re
import warnings
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stepgap.base.errors import InputError, StepGapWarning
from stepgap.logs.columns import Columns, read_columns
from stepgap.logs.foreign_log import FoundSteps, read_foreign_logs, step_log_of
from stepgap.logs.tables import reading
from stepgap.records.steps_csv import RecordError

NUMBERS = st.floats(-1e12, 1e12) | st.just(float("nan"))
WHOLE = Columns(state=("v", "y"), next=("v2", "y2"), command=("f",))


def read(text: str | bytes, columns: Columns) -> FoundSteps:
    with TemporaryDirectory() as folder:
        path = Path(folder) / "log.csv"
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return read_foreign_logs([path], columns)


def written(names: Sequence[str], rows: Sequence[Sequence[object]], delimiter: str = ",") -> str:
    return "\n".join(delimiter.join(map(str, row)) for row in (names, *rows)) + "\n"


@settings(max_examples=60, deadline=None)
@given(
    st.lists(st.tuples(*[NUMBERS] * 6), min_size=1, max_size=20),
    st.permutations(["v", "y", "v2", "y2", "f", "other"]),
    st.sampled_from(",;\t"),
)
def test_every_number_is_read(rows: list[tuple[float, ...]], names: list[str], delimiter: str) -> None:
    table = np.array(rows)
    used = [names.index(name) for name in ("v", "y", "v2", "y2", "f")]
    whole = np.isfinite(table[:, used]).all(axis=1)
    text = written(names, [["" if np.isnan(cell) else repr(cell) for cell in row] for row in rows], delimiter)
    if not whole.any():
        with pytest.raises(RecordError, match="no row holds a complete step"):
            read(text, WHOLE)
        return
    steps, _, origin, left_out = read(text, WHOLE)
    found = np.hstack([steps.state, steps.next_state, steps.command])
    np.testing.assert_array_equal(found, table[whole][:, used])
    assert sum(left_out.values()) == len(rows) - whole.sum()
    assert [int(text.rpartition(" ")[2]) - 2 for text in origin] == np.flatnonzero(whole).tolist()
    for quantity, values in zip((*steps.space.state, *steps.space.command), found[:, [0, 1, 4]].T, strict=True):
        assert quantity.lower <= values.min()
        assert values.max() <= quantity.upper


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(st.integers(0, 3), st.booleans(), NUMBERS, NUMBERS), min_size=2, max_size=30))
def test_rows_chain_as_if_the_next_state_were_written(rows: list[tuple[int, bool, float, float]]) -> None:
    """Each row: trial, whether a step was skipped before it, state, command."""
    count = np.cumsum([1 + skipped for _, skipped, _, _ in rows])
    follows = [
        earlier[0] == later[0] and step == 1
        for earlier, later, step in zip(rows, rows[1:], np.diff(count), strict=False)
    ]
    pairs = [(a, b) for a, b, chained in zip(rows, rows[1:], follows, strict=False) if chained]
    pairs = [(a, b) for a, b in pairs if np.isfinite([a[2], b[2]]).all()]
    text = written(["trial", "n", "v", "f"], [(row[0], n, *row[2:]) for row, n in zip(rows, count, strict=True)])
    forward = [(a[2], a[3], b[2]) for a, b in pairs if np.isfinite(a[3])]
    backward = [(a[2], b[3], b[2]) for a, b in pairs if np.isfinite(b[3])]
    common: dict[str, Any] = {"command": ("f",), "deployment": "trial", "step": "n"}
    for columns, expected in (
        (Columns(state=("v",), **common), forward),
        (Columns(next=("v",), **common), backward),
    ):
        if not expected:
            with pytest.raises(RecordError, match="no row holds a complete step"):
                read(text, columns)
            continue
        steps, _, _, left_out = read(text, columns)
        np.testing.assert_array_equal(np.hstack([steps.state, steps.command, steps.next_state]), expected)
        assert left_out.get("at the end of a chain", 0) == len(rows) - sum(follows)


@settings(max_examples=80, deadline=None)
@given(st.binary(max_size=60) | st.text(max_size=60).map(lambda text: b"v,y,v2,y2,f\n" + text.encode()))
def test_any_content_of_a_file_gives_one_kind_of_error(content: bytes) -> None:
    steps, message = None, ""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", StepGapWarning)
            steps = read(content, WHOLE).steps
    except RecordError as error:
        message = str(error)
    if steps is None:
        assert "log.csv" in message
        assert len(message) < 600
    else:
        assert np.isfinite(np.hstack([steps.state, steps.next_state, steps.command])).all()


def test_units_factors_names_and_targets() -> None:
    columns = Columns(
        state=("speed=v_mm", "height=y"),
        target=("v_ref", "y_ref"),
        units={"v_mm": "m/s", "y": "m"},
        factors={"v_mm": 1e-3, "v_ref": 1e-3},
    )
    text = "\ufeff" + written(["v_mm", "y", "v_ref", "y_ref"], [(100, 0.5, 200, 0.6), (150, 0.55, 200, 0.6)])
    steps = read(text, columns).steps
    assert [(q.name, q.unit) for q in steps.space.state] == [("speed", "m/s"), ("height", "m")]
    assert steps.space.command_names == ("v_ref", "y_ref")
    np.testing.assert_allclose(steps.state, [[0.1, 0.5]])
    np.testing.assert_allclose(steps.next_state, [[0.15, 0.55]])
    np.testing.assert_allclose(steps.command, [[0.2, 0.6]])
    np.testing.assert_array_equal(steps.target, steps.command)
    assert np.isnan(steps.predicted).all()
    for quantity in steps.space.command:
        assert quantity.lower < quantity.upper, "although its values are all equal"


def test_each_file_is_a_deployment(tmp_path: Path) -> None:
    for name in "ab":
        (tmp_path / name).write_text(written(["v", "f", "trial"], [(1, 0, 1), (2, 0, 1), (3, 0, 2), (4, 0, 2)]))
    columns = Columns(state=("v",), command=("f",), deployment="trial")
    steps, _, _, left_out = read_foreign_logs([tmp_path / "a", tmp_path / "b"], columns)
    np.testing.assert_array_equal(steps.iteration, [0, 1, 2, 3])
    assert left_out == {"at the end of a chain": 4}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("v,y,v2,y2\n", "log.csv, line 1: command 'f': no column 'f'; there is v, y, v2, y2"),
        ("v,y,next_v2,y2,f\n", "log.csv, line 1: next 'v2': no column 'v2'; did you mean"),
        ("v,y,v2,y2,f,f\n", "log.csv, line 1: command 'f': more than one such column"),
        ("v,y,v2,y2,f\n", "log.csv: no row holds a complete step; rows left out: none"),
        ("v,y,v2,y2,f\n\n1,2,3,4,1e13\n", "log.csv, line 3, column 'f': '1e13'; it must be a number within"),
        ("v,y,v2,y2,f\n1,2,3,4,\n1,2,3,nan,5\n", "log.csv: no row holds a complete step; rows left out: 2"),
    ],
)
def test_faults_of_a_file_are_named(text: str, message: str) -> None:
    with pytest.raises(RecordError, match=re.escape(message)):
        read(text, WHOLE)


def test_a_file_too_large_is_not_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reading, "LARGEST_LOG", 20)
    (tmp_path / "log.csv").write_text("v,y,v2,y2,f\n1,2,3,4,5\n")
    with pytest.raises(RecordError, match="larger than 20 bytes"):
        read_foreign_logs([tmp_path / "log.csv"], WHOLE)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"command": ("f",)}, "state: no column"),
        ({"state": ("v",)}, "command: no column"),
        ({"state": ("v", "y"), "next": ("v2",), "command": ("f",)}, "next: 1 columns; it must have as many"),
        ({"state": ("v",) * 101, "command": ("f",)}, "state: 101 columns; it must have at most 100"),
        ({"state": ("v",), "command": ("x=f", "v=g")}, "give each a different name"),
        ({"state": ("v",), "command": ("f",), "units": {"w": "m"}}, "units: no column 'w'; "),
        ({"state": ("v",), "command": ("f",), "factors": {"f": 0.0}}, "factors.f = 0.0, but its magnitude must"),
        (
            {"state": ("v",), "command": ("f",), "factors": {"f": float("nan")}},
            "factors.f = nan, but its magnitude must",
        ),
    ],
)
def test_columns_must_fit_each_other(arguments: dict, message: str) -> None:
    with pytest.raises(ValueError, match=re.escape(message)):
        Columns(**arguments)


def test_columns_from_a_file_and_options(tmp_path: Path) -> None:
    file = tmp_path / "columns.toml"
    file.write_text('state = ["v"]\ncommand = ["f"]\nstep = "n"\n[units]\nv = "m/s"\n[factors]\nv = 2\n')
    assert read_columns(None, {}) is None
    expected = Columns(("v",), ("a",), ("f", "g"), step="n", units={"v": "m/s"}, factors={"v": 2})
    assert read_columns(file, {"next": ("a",), "command": ("f", "g")}) == expected


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (b"sate = ['v']", "sate: unknown key; did you mean state?"),
        (b"state = 'v'", "state = 'v', but it must be a list of strings"),
        (b"state = ['']\ncommand = ['f']", "state = '', but it must be names, and none may be"),
        (b"step = 3", "step = 3, but it must be a string"),
        (b"[units]\nv = 3", "units.v = 3, but it must be a string"),
        (b"[factors]\nv = true", "factors.v = true, but it must be a number"),
        (b"state = ['v']", "command: no column"),
        (b"state = ", "not TOML"),
        (b"\xff", "this is not text; a file of columns is a TOML file in UTF-8"),
        (b"#" * 2**21, "larger than"),
    ],
)
def test_faults_of_a_file_of_columns_are_named(tmp_path: Path, text: bytes, message: str) -> None:
    file = tmp_path / "columns.toml"
    file.write_bytes(text)
    with pytest.raises(InputError, match=re.escape(message)) as caught:
        read_columns(file, {})
    assert str(caught.value).startswith(f"{file}: ")


@pytest.mark.parametrize("columns", [Columns(state=("v",), command=("f",)), Columns(next=("v",), command=("f",))])
def test_a_yaw_belongs_to_the_start_of_a_step_and_may_be_missing(columns: Columns) -> None:
    rows = [(0.1 * row, 1, "" if row == 2 else 10 * row) for row in range(5)]
    text = written(("v", "f", "psi"), rows)
    found = read(text, replace(columns, yaw="psi", factors={"psi": 0.1}))
    np.testing.assert_allclose(found.steps.state[:, 0], [0, 0.1, 0.2, 0.3])
    np.testing.assert_allclose(found.phase, [0, 1, np.nan, 3])
    assert np.isnan(read(text, columns).phase).all()


def test_a_yaw_is_left_out_with_its_row() -> None:
    columns = Columns(state=("a",), next=("b",), command=("f",), yaw="psi")
    found = read(written(("a", "b", "f", "psi"), [(0, 1, 2, 3), (1, "", 2, 4), (1, 1, 1, 5)]), columns)
    assert found.phase.tolist() == [3, 5]


def test_the_yaw_after_a_step_is_that_at_the_start_of_the_next_one() -> None:
    """Rows 0, 1 and 2, 3 are chained; row 4 is chained, but its yaw is missing; row 5 belongs to another trial."""
    columns = Columns(state=("a",), next=("b",), command=("f",), yaw="psi", deployment="trial")
    rows = [
        (0, 1, 2, 0.1, 1),
        (1, 2, 2, 0.2, 1),
        (5, 6, 2, 0.3, 1),
        (6, 7, 2, 0.4, 1),
        (7, 8, 2, "", 1),
        (8, 9, 2, 0.6, 2),
    ]
    text = written(("a", "b", "f", "psi", "trial"), rows)
    log = step_log_of(read(text, columns))
    assert [(logged.iteration, logged.step) for logged in log] == [(0, 1), (0, 2), (1, 1), (1, 2), (1, 3), (2, 1)]
    nan = np.nan
    np.testing.assert_array_equal(log.context[:, 0], [0.2, nan, 0.4, nan, nan, nan])
    np.testing.assert_array_equal(log.phase, [nan, 0.2, nan, 0.4, nan, nan], "but for the first step of a deployment")
    assert np.isnan(log.target).all(), "the log has no targets"
    without = step_log_of(read(text, replace(columns, yaw="")))
    assert without.context.shape == (6, 0)


def test_numbered_steps_follow_each_other_above_a_ground_that_changes() -> None:
    """Each step starts at another height above its ground than that in which the step before ended."""
    rows = [(7, 0.1, 0.56, 0.2, 0.58, 1.0), (8, 0.2, 0.53, 0.3, 0.57, 2.0), (10, 0.3, 0.57, 0.1, 0.59, 3.0)]
    text = written(["step", "v", "y", "v2", "y2", "f"], rows)
    assert read(text, replace(WHOLE, step="step")).steps.follows.tolist() == [False, True, False]
    assert read(text, WHOLE).steps.follows.tolist() == [False, False, True]
    log = step_log_of(read(text, replace(WHOLE, step="step")))
    assert list(zip(log.iteration.tolist(), log.number.tolist(), strict=True)) == [(0, 1), (0, 2), (1, 1)]

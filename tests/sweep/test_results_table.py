"""`results.csv`: numbers come back without loss, and any other file is refused by one line."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from stepgap.records.summary import MEASURES
from stepgap.robots.hopper.parameters import CommandBounds
from stepgap.sweep.results_table import as_numbers, columns_of, read_results, rows_of_results, table_text

SPACE = CommandBounds().space()
NAMES = ("gap.delay", "seed")


def entry(iteration: int, error: float | None, hops: Any = None) -> dict[str, Any]:
    errors = {measure: dict.fromkeys(SPACE.state_names, error) for measure in MEASURES}
    targets = {"cut": 0, "unreachable": [], "missed": [[0.1, 0.6]]}
    return {"iteration": iteration, "residual": "gp", "steps": 9, "falls": 0, "hops_to_band": hops, **errors, **targets}


def written(path: Path, *cases: tuple[dict[str, Any], Any, str]) -> Path:
    rows = [row for number, case in enumerate(cases) for row in rows_of_results(number, *case, SPACE)]
    path.write_text(table_text(columns_of(NAMES, SPACE), rows), encoding="utf-8")
    return path


@given(st.floats(-1e9, 1e9), st.integers(0, 2**63 - 1), st.text(max_size=20))
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_numbers_come_back_without_loss(tmp_path: Path, error: float, seed: int, name: str) -> None:
    reason = " ".join(name.split()) or "bad"
    if "\0" in reason:
        return
    values = {"gap.delay": error, "seed": seed}
    path = written(tmp_path / "r.csv", (values, [entry(0, error), entry(1, None, 7)], ""), (values, None, reason))
    found = read_results(path)
    assert (found.settings, found.state_names, len(found)) == (NAMES, SPACE.state_names, 3)
    assert found.columns["rmse_speed"][0] == error
    assert np.isnan(found.columns["rmse_speed"][1:]).all()
    assert found.columns["hops_to_band"][1] == 7
    assert found.columns["failed"].tolist() == ["", "", reason]
    assert as_numbers(found.columns["seed"]).tolist() == [seed] * 3
    assert as_numbers(found.columns["gap.delay"])[0] == error


def test_texts_stay_texts() -> None:
    assert as_numbers(np.array(["1", "x"], dtype=object)).tolist() == ["1", "x"]
    assert as_numbers(np.array(["1", "0.5"], dtype=object)).tolist() == [1, 0.5]


@pytest.mark.parametrize(
    "result", [None, [], [3], [{}], [entry(0, 1.0, "soon")], [entry(0, 1.0, 0)], [entry(0, 1e30)], {"iteration": 0}]
)
def test_what_is_no_deployment_is_refused(result: Any) -> None:
    with pytest.raises(ValueError, match="case 4"):
        rows_of_results(4, {}, result, "", SPACE)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.binary(max_size=200), st.integers(0, 400), st.booleans())
def test_a_damaged_table_is_refused_by_its_name_or_read(
    tmp_path: Path, noise: bytes, position: int, instead: bool
) -> None:
    path = written(tmp_path / "r.csv", ({"gap.delay": 0.1, "seed": 1}, [entry(0, 0.5), entry(1, 0.2, 30)], ""))
    content = path.read_bytes()
    path.write_bytes(noise if instead else content[:position] + noise + content[position:])
    try:
        read_results(path)
        message = ""
    except ValueError as error:
        message = str(error)
    assert "\n" not in message
    assert not message or str(path) in message

"""Model files that are damaged or made up: one line says so, and no large memory is needed."""

import json
import math
import tracemalloc
from collections.abc import Callable
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from stepgap.gauss.gaussian_process import condition
from stepgap.learning.entry_points import load_residual_model
from stepgap.learning.gaussian_process_regression import GaussianProcessRegression
from stepgap.learning.residual import Residual, no_residual
from stepgap.records.model_files import MAP, NominalSource, read_saved_model, saved_model_text
from tests.export.controller.learned import SCALE, SPACE, affine, regression

NOMINAL = affine(np.random.default_rng(0))
SOURCE = NominalSource(MAP, NOMINAL)
LARGEST_MEMORY = 2**26
"""Most memory that reading a small broken file may take [bytes]; 64 MiB."""


def model(kind: str) -> dict[str, Any]:
    """Content of an intact model file."""
    rng = np.random.default_rng(0)
    if kind == "none":
        residual = no_residual(2, 2)
    else:
        found = regression(kind, 0.2, rng)
        if kind == "gp_on_linear":  # an exact process; the others are sparse
            assert isinstance(found, GaussianProcessRegression)
            process = condition(found.points, found.values, SCALE, found.process.hyper_parameters)
            found = GaussianProcessRegression(process)
        residual = Residual(load_residual_model(kind), (found, found), 2)
    return json.loads(saved_model_text(residual, SPACE, SOURCE))


MODELS = {kind: model(kind) for kind in ("none", "posterior", "quadratic", "gp", "gp_on_linear")}


def answer(path: Path, content: str | bytes) -> str:
    """The one line with which a file is refused; empty if it is read."""
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    tracemalloc.start()
    try:
        read_saved_model(path, SPACE, SOURCE)
        return ""
    except ValueError as error:
        line = str(error)
        assert line.startswith(f"{path}: ")
        assert "\n" not in line
        assert len(line) < len(str(path)) + 300
        return line
    finally:
        _, peak = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        assert peak < LARGEST_MEMORY


def value_paths(content: Any, path: tuple[str | int, ...] = ()) -> list[tuple[str | int, ...]]:
    """Paths to the values in a model file; of a list of values, the first and the last."""
    if isinstance(content, dict):
        found = [value_paths(value, (*path, key)) for key, value in content.items()]
    elif isinstance(content, list) and content:
        found = [value_paths(content[index], (*path, index)) for index in {0, len(content) - 1}]
    else:
        found = []
    return [*([path] if path else []), *(each for part in found for each in part)]


def changed(content: Any, path: tuple[str | int, ...], change: Callable[[Any], Any]) -> Any:
    """The content with another value at a path."""
    content = deepcopy(content)
    inner = content
    for key in path[:-1]:
        inner = inner[key]
    last = path[-1]
    before = inner.get(last) if isinstance(inner, dict) else inner[last]
    inner[last] = change(before)
    return content


HUGE = 10**400
WRONG = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-5, 5),
    st.sampled_from([HUGE, -HUGE, 10**9, 2**63, 1e308, -1e308, 1e-320, math.nan, math.inf, -math.inf, 0.0, -1.0]),
    st.text(max_size=5),
    st.lists(st.floats(), max_size=5),
    st.lists(st.lists(st.floats(-3, 3), max_size=3), max_size=4),
    st.dictionaries(st.text(max_size=3), st.integers(), max_size=2),
    st.just([[[0.0]]]),
)

quickly = settings(max_examples=80, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


@pytest.mark.parametrize("kind", MODELS)
def test_intact_files_are_read(kind: str, tmp_path: Path) -> None:
    assert answer(tmp_path / "model.json", json.dumps(MODELS[kind])) == ""


@pytest.mark.parametrize("kind", ["posterior", "gp", "gp_on_linear", "quadratic"])
def test_nothing_and_huge_numbers_everywhere_are_one_line_or_harmless(kind: str, tmp_path: Path) -> None:
    found = value_paths(MODELS[kind])
    assert len(found) > 30
    for path in found:
        for wrong in (None, HUGE):
            answer(tmp_path / "model.json", json.dumps(changed(MODELS[kind], path, lambda _, wrong=wrong: wrong)))


@given(data=st.data(), kind=st.sampled_from(sorted(MODELS)))
@quickly
def test_a_wrong_value_anywhere_is_one_line_or_harmless(data: st.DataObject, kind: str, tmp_path: Path) -> None:
    path = data.draw(st.sampled_from(value_paths(MODELS[kind])))
    wrong = data.draw(WRONG)
    answer(tmp_path / "model.json", json.dumps(changed(MODELS[kind], path, lambda _: wrong)))


@given(data=st.data(), kind=st.sampled_from(sorted(MODELS)))
@quickly
def test_a_missing_value_is_one_line_or_harmless(data: st.DataObject, kind: str, tmp_path: Path) -> None:
    *path, last = data.draw(st.sampled_from(value_paths(MODELS[kind])))
    content = deepcopy(MODELS[kind])
    inner: Any = content
    for key in path:
        inner = inner[key]
    del inner[last]
    answer(tmp_path / "model.json", json.dumps(content))


@given(data=st.data(), kind=st.sampled_from(sorted(MODELS)))
@quickly
def test_a_truncated_file_is_refused(data: st.DataObject, kind: str, tmp_path: Path) -> None:
    text = json.dumps(MODELS[kind])
    length = data.draw(st.integers(0, len(text) - 1))
    assert "not a residual" in answer(tmp_path / "model.json", text[:length])


@given(content=st.binary(max_size=60))
@quickly
def test_other_bytes_are_refused(content: bytes, tmp_path: Path) -> None:
    assert answer(tmp_path / "model.json", content)


@given(
    content=st.recursive(
        WRONG, lambda inner: st.dictionaries(st.sampled_from(sorted(MODELS["gp"])), inner), max_leaves=6
    )
)
@quickly
def test_other_json_is_refused(content: Any, tmp_path: Path) -> None:
    assert answer(tmp_path / "model.json", json.dumps(content))


def rows(count: int, columns: int) -> dict[str, Any]:
    """A regression of this many points."""
    return {"points": [[0.0] * columns] * count, "values": [0.0] * count}


@pytest.mark.parametrize(
    ("kind", "path", "change", "message"),
    [
        ("gp", ("schema",), lambda _: 2, "schema must be 1, not 2"),
        ("gp", ("schema",), lambda _: None, "schema must be 1, not None"),
        ("gp", ("format",), lambda _: "StepGap model", "exported for other programs; give models/iteration_K.json"),
        ("gp", ("kind",), lambda _: "neural_network", "neural_network"),
        ("gp", ("kind",), lambda _: "__import__('os').system('true')", "not a residual"),
        ("gp", ("nominal",), lambda _: "target", "learned with '--nominal target'"),
        ("gp", ("nominal_steps",), lambda _: [[1.0]], "has (1, 1) numbers of steps, this version compares (9, 2)"),
        ("gp", ("nominal_steps", 0, 0), lambda one: one + 0.25, "was learned on another nominal map: at speed "),
        ("gp", ("nominal_steps", 4, 1), lambda _: None, "its next height was none (the step fails), that of"),
        ("gp", ("lagged_inputs",), lambda _: "previous_step", "models with inputs of the step before are gone"),
        ("gp", ("command",), lambda _: [["fx", "N"], ["fy", "kN"]], "fy has the unit 'kN', in the steps 'N'; convert"),
        (
            "gp",
            ("command",),
            lambda _: [["fx", "N"], ["fz", "N"]],
            "its command is fx, fz, that of the steps is fx, fy",
        ),
        ("gp", ("state",), lambda _: None, "has no names of state and command"),
        ("gp", ("state", 0), lambda _: ["speed"], "speed must be a pair of name and unit"),
        ("none", ("command_size",), lambda _: 10**9, "command_size 1000000000: must be at most 100"),
        ("none", ("regressions",), lambda one: one * 200, "400 regressions, command_size 2: must be at most 100"),
        ("none", ("regressions", 0, "inputs"), lambda _: 10**12, "must have 4 inputs"),
        ("none", ("regressions", 0, "noise_std"), lambda _: -1.0, "noise_std must not be negative"),
        (
            "quadratic",
            ("regressions", 0),
            lambda one: {**one, **rows(1, 3000), "centre": [0.0] * 3000, "scale": [1.0] * 3000},
            "regressions[0].points must have at most 100 columns",
        ),
        (
            "gp_on_linear",
            ("regressions", 0),
            lambda one: {**one, **rows(7000, 4)},
            "regressions[0].points.shape = (7000, 4), but it must have at most 6000 rows",
        ),
        (
            "gp",
            ("regressions", 1, "inducing"),
            lambda one: one[:1] * 2000,
            "regressions[1].inducing.shape = (2000, 4), but it must have at most 1000 rows",
        ),
    ],
)
def test_each_fault_is_named(kind: str, path: Any, change: Callable[[Any], Any], message: str, tmp_path: Path) -> None:
    content = {"format": None, **MODELS[kind]} if path == ("format",) else MODELS[kind]
    assert message in answer(tmp_path / "model.json", json.dumps(changed(content, path, change)))


def test_deep_nesting_and_large_files_are_refused(tmp_path: Path) -> None:
    assert "not a residual" in answer(tmp_path / "model.json", "[" * 100_000)
    large = tmp_path / "large.json"
    with large.open("wb") as file:
        file.truncate(2**30)  # sparse: it takes no room on disk
    with pytest.raises(ValueError, match=r"large\.json: larger than 67108864 bytes, so it is not read"):
        read_saved_model(large, SPACE, SOURCE)

"""The model file: read back, validated, and read by the code of its page."""

import json
import re
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stepgap.base.errors import InputError
from stepgap.export.controller import model_reading
from stepgap.export.controller.model_document import filter_after, model_document, model_text
from stepgap.export.controller.model_reading import read_portable
from stepgap.learning.disturbance import DisturbanceFilter
from stepgap.learning.steps import LoggedStep, Steps
from stepgap.step import StepRecord, StepSpace, StepStatus
from tests.control.maps import YAW
from tests.export.controller.learned import CENTRE, KINDS, SPACE, learned, steps

PAGE = Path(__file__).parents[3] / "docs" / "model_file.md"
READER, ONLINE = re.findall(r"```python\n(.*?)```", PAGE.read_text("utf-8"), re.DOTALL)
"""The blocks of "model_file.md"."""
SCHEMA = json.loads(Path(model_reading.__file__).with_name("model_file.schema.json").read_text("utf-8"))


def reader(kind: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, **options: bool) -> dict[str, Any]:
    """What the code of the page defines, given a model file."""
    monkeypatch.chdir(tmp_path)
    Path("model.json").write_text(model_text(learned(kind, **options)), "utf-8")
    names: dict[str, Any] = {}
    exec(compile(READER + ONLINE, "model_file.md", "exec"), names)  # noqa: S102  (our own page)
    return names


@pytest.mark.parametrize("linear", [False, True], ids=["legendre", "affine"])
@pytest.mark.parametrize("kind", KINDS)
def test_forty_lines_of_the_page_compute_the_same_map(kind: str, linear: bool, monkeypatch, tmp_path) -> None:
    names, step_map = reader(kind, monkeypatch, tmp_path, linear=linear), learned(kind, linear=linear).map
    for state, command in zip(*steps(40), strict=True):
        point = np.concatenate([state, command])
        mean, std = np.transpose([names["mean_and_std"](part, point) for part in names["regressions"]])
        assert np.abs(names["next_state"](point) + mean - step_map(state, command)).max() < 1e-9
        assert np.abs(std - step_map.std(state, command)).max() < 1e-9


def test_the_reader_has_forty_lines() -> None:
    assert len([line for line in READER.splitlines() if line.strip()]) <= 40


@pytest.mark.parametrize("kind", KINDS[1:])
def test_the_page_follows_a_drift_as_the_filter_does(kind: str, monkeypatch, tmp_path) -> None:
    names, rng = reader(kind, monkeypatch, tmp_path), np.random.default_rng(3)
    found, expected = names["f"], DisturbanceFilter.initial(2)
    used = 0
    for yaw in [np.nan, *rng.uniform(0, 7, 60)]:
        offset, std = names["offset_and_std"](found, yaw)
        assert np.abs(offset - expected.offset(yaw)).max() < 1e-9
        assert np.abs(std - expected.std(yaw) * names["noise"]).max() < 1e-9
        used += bool(np.any(offset))
        error = np.array([0.05, 0.01]) * (1 + np.nan_to_num(np.sin(yaw))) + 0.002 * rng.normal(size=2)
        found, expected = names["after"](found, error, yaw), expected.updated(error, yaw)
    assert used > 20, "the filter is in use"


@pytest.mark.parametrize("failing", [False, True])
@pytest.mark.parametrize("kind", KINDS)
def test_a_file_read_back_is_the_same_controller(kind: str, failing: bool, tmp_path: Path) -> None:
    file, written = tmp_path / "model.json", learned(kind, failing=failing)
    file.write_text(model_text(written), "utf-8")
    jsonschema.validate(json.loads(file.read_text("utf-8")), SCHEMA)
    found, (state, command) = read_portable(file), steps(200)
    expected, outcome = written.map.evaluate(state, command), found.map.evaluate(state, command)
    assert np.array_equal(outcome.status, expected.status)
    assert (len(set(expected.status)) > 2) == failing
    assert np.allclose(outcome.next_state, expected.next_state, rtol=0, atol=1e-12, equal_nan=True)
    assert np.allclose(found.map.std(state, command), written.map.std(state, command), rtol=0, atol=1e-12)
    assert np.array_equal(found.failures, written.failures)
    assert (found.settings, found.drift, found.monitor, found.space) == (
        written.settings, written.drift, written.monitor, written.space)  # fmt: skip
    assert json.loads(file.read_text("utf-8"))["disturbance"]["end"] is None


def test_the_filter_at_the_end_of_a_deployment_is_in_the_file(tmp_path: Path) -> None:
    controller, rng = learned("gp"), np.random.default_rng(2)
    log, expected, yaw = [], DisturbanceFilter.initial(2), np.nan
    for number, (state, command) in enumerate(zip(*steps(8, spread=0.9), strict=True)):
        error = 0.02 * rng.normal(size=2)
        failed, after = number == 5, float(rng.uniform(0, 6))
        record = StepRecord(
            state, command, command, np.full(2, np.nan) if failed else controller.map(state, command) + error,
            StepStatus.FELL if failed else StepStatus.OK, {} if failed else {"yaw": after})  # fmt: skip
        log.append(LoggedStep(0, number, state, state, np.zeros(2), record))
        expected = expected if failed else expected.updated(error, yaw)
        yaw = record.context.get("yaw", np.nan)
    file = tmp_path / "model.json"
    file.write_text(
        model_text(controller, filter_after(controller, Steps(StepSpace(SPACE.state, SPACE.command, (YAW,)), log))),
        "utf-8",
    )
    read_portable(file)  # which refuses a filter that cannot be read
    found = json.loads(file.read_text("utf-8"))["disturbance"]["end"]
    assert np.allclose(found["coefficients"], expected.coefficients, rtol=0, atol=1e-12)
    assert np.allclose(found["scores"], expected.scores, rtol=0, atol=1e-12)
    assert found["weight"] == pytest.approx(expected.weight)


def paths_in(value: Any, at: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Paths of all keys of a document that a controller depends on, and of the first entry of each list."""
    if isinstance(value, dict):
        ignored = ("stepgap", "approximations", "notes", "end")
        inner = [(key, each) for key, each in value.items() if key not in ignored]
    else:
        inner = [(0, value[0])] if isinstance(value, list) and value else []
    return [path for key, each in inner for path in [(*at, key), *paths_in(each, (*at, key))]]


DOCUMENTS = {kind: model_document(learned(kind, failing=True)) for kind in ("quadratic", "gp")}
MIDDLE = CENTRE[:2], CENTRE[2:]
BROKEN = st.sampled_from([None, "text", [], {}, [[1.0]], -7.5, 10**400, True, [None]])


@settings(max_examples=120, deadline=None, derandomize=True)
@given(st.data())
def test_a_wrong_value_anywhere_is_one_clear_line(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    document = json.loads(json.dumps(DOCUMENTS[data.draw(st.sampled_from(sorted(DOCUMENTS)))]))
    path, wrong = data.draw(st.sampled_from(paths_in(document))), data.draw(BROKEN)
    part = document
    for key in path[:-1]:
        part = part[key]
    if part[path[-1]] == wrong:
        return
    part[path[-1]] = wrong
    file = tmp_path_factory.getbasetemp() / "broken.json"
    file.write_text(json.dumps(document), "utf-8")
    message = refusal(file)
    if message:
        assert message.startswith(str(file)), message
        assert "\n" not in message
    else:
        assert path[0] in ("failures", "state", "command", "nominal", "control", "disturbance", "monitor"), path
        assert np.isfinite(read_portable(file).map(*MIDDLE)).all()


def refusal(file: Path) -> str:
    """The message with which a file is refused; empty if it is read."""
    try:
        read_portable(file)
    except InputError as error:
        return str(error)
    return ""


@pytest.mark.parametrize(("text", "message"), [
    ("", "Expecting value"), ("[]", "format must be"), ("{", "not a model file"), ('{"format": "x"}', "format must be"),
    ('{"format": "StepGap model", "schema": 3}', "schema must be 2, not 3"), ("[" * 100_000, "not a model file"),
    ('{"format": "StepGap model", "schema": 2}', "not a model file"),
])  # fmt: skip
def test_another_file_is_refused(text: str, message: str, tmp_path: Path) -> None:
    file = tmp_path / "other.json"
    file.write_text(text, "utf-8")
    with pytest.raises(InputError, match=message):
        read_portable(file)


def test_numbers_that_do_not_follow_from_the_data_are_refused(tmp_path: Path) -> None:
    document = json.loads(json.dumps(DOCUMENTS["gp"]))
    document["residual"]["regressions"][1]["weights"][3] += 0.1
    file = tmp_path / "edited.json"
    file.write_text(json.dumps(document), "utf-8")
    with pytest.raises(InputError, match=r"residual.regressions\[1\].weights does not follow from the data"):
        read_portable(file)

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
from stepgap.export.controller.model_document import model_document, model_text
from stepgap.export.controller.model_reading import read_portable
from stepgap.export.controller.portable_controller import PortableController
from stepgap.step import StepStatus
from tests.export.controller.changing_robot import ChangingRobot
from tests.export.controller.learned import CENTRE, KINDS, SPACE, learned, steps

PAGE = Path(__file__).parents[3] / "docs" / "model_file.md"
READER, ONLINE = re.findall(r"```python\n(.*?)```", PAGE.read_text("utf-8"), re.DOTALL)
"""The blocks of "model_file.md"."""
SCHEMA = json.loads(Path(model_reading.__file__).with_name("model_file.schema.json").read_text("utf-8"))


def reader(controller: PortableController, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> dict[str, Any]:
    """What the code of the page defines, given a model file."""
    monkeypatch.chdir(tmp_path)
    Path("model.json").write_text(model_text(controller), "utf-8")
    names: dict[str, Any] = {}
    code = READER if controller.beliefs is None else READER + ONLINE
    exec(compile(code, "model_file.md", "exec"), names)  # noqa: S102  (our own page)
    return names


@pytest.mark.parametrize("linear", [False, True], ids=["legendre", "affine"])
@pytest.mark.parametrize("kind", KINDS)
def test_fifty_lines_of_the_page_compute_the_fitted_map(kind: str, linear: bool, monkeypatch, tmp_path) -> None:
    controller = learned(kind, linear=linear, drift=False)
    names, step_map = reader(controller, monkeypatch, tmp_path), controller.map
    for state, command in zip(*steps(40), strict=True):
        point = np.concatenate([state, command])
        mean, std = np.transpose([names["mean_and_std"](part, point) for part in names["regressions"]])
        assert np.abs(names["next_state"](point) + mean - step_map(state, command)).max() < 1e-9
        assert np.abs(std - step_map.std(state, command)).max() < 1e-9


def test_the_reader_has_fifty_lines() -> None:
    assert len([line for line in READER.splitlines() if line.strip()]) <= 50


@pytest.mark.parametrize("kind", ["posterior", "gp"])
def test_the_page_believes_what_python_believes(kind: str, monkeypatch, tmp_path) -> None:
    controller = learned(kind, linear=True)
    names, robot = reader(controller, monkeypatch, tmp_path), ChangingRobot(controller)
    found, beliefs, rng, alarms = names["start"], controller.beliefs, np.random.default_rng(3), set()
    while robot.is_on_its_way:
        assert beliefs
        expected, (mean, covariance, noise) = beliefs.mixture(0.3), names["mixture"](found)
        assert np.abs(mean - expected.mean).max() < 1e-7
        assert np.abs(covariance - expected.covariance).max() < 1e-7
        assert np.abs(noise - expected.noise).max() < 1e-7
        doubt = found["doubt"]
        assert np.abs((doubt["w"] * doubt["offset"] if doubt else 0.0) - expected.offset).max() < 1e-6
        record, phase = robot.step(SPACE.command_at(rng.uniform(-1, 1, 2)))
        point = np.concatenate([record.state, record.command])
        found = names["after"](found, point, record.next_state, phase)
        beliefs = controller.after(beliefs, record, phase)
        assert beliefs
        assert found["alarm"] == beliefs.alarm
        alarms.add(beliefs.alarm)
        assert [each["kind"] for each in found["beliefs"]] == [each.kind for each in beliefs.beliefs]
        weights = [each["log_weight"] for each in found["beliefs"]]
        assert np.allclose(weights, [each.log_weight for each in beliefs.beliefs], rtol=0, atol=1e-5)
    assert {"changed", "earlier"} <= alarms


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
    assert (found.settings, found.space) == (written.settings, written.space)


@pytest.mark.parametrize(("keys", "value", "message"), [
    (("beliefs", 0, "kind"), "other", "kind must be one of family, unknown"),
    (("beliefs", 0, "mean"), [[1.0]], "mean.shape"),
    (("beliefs", 0, "root", 1, 0), -1.0, "diagonal"),
    (("beliefs", 0, "freedom", 0), 1.0, "freedom"),
    (("beliefs",), [], "beliefs must be a list"),
    (("features", "inputs"), 3, "features"),
    (("constants", "hazard"), 0.5, "beliefs.constants.hazard does not follow from the data"),
    (("steps", "state"), [[1.0]], "state must be finite numbers of shape"),
])  # fmt: skip
def test_damaged_beliefs_are_refused(keys: tuple[Any, ...], value: Any, message: str, tmp_path: Path) -> None:
    document = json.loads(json.dumps(DOCUMENTS["posterior"]))
    part = document["beliefs"]
    for key in keys[:-1]:
        part = part[key]
    part[keys[-1]] = value
    file = tmp_path / "model.json"
    file.write_text(json.dumps(document), "utf-8")
    with pytest.raises(InputError, match=message):
        read_portable(file)


def paths_in(value: Any, at: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Paths of all keys of a document that a controller depends on, and of the first entry of each list."""
    if isinstance(value, dict):
        ignored = ("stepgap", "approximations", "notes")
        inner = [(key, each) for key, each in value.items() if key not in ignored]
    else:
        inner = [(0, value[0])] if isinstance(value, list) and value else []
    return [path for key, each in inner for path in [(*at, key), *paths_in(each, (*at, key))]]


DOCUMENTS = {kind: model_document(learned(kind, failing=True)) for kind in ("posterior", "quadratic", "gp")}
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
        assert path[0] in ("failures", "state", "command", "nominal", "control", "beliefs"), path
        outcome = read_portable(file).map.evaluate(*MIDDLE)
        assert np.isfinite(outcome.next_state).all() or outcome.status != StepStatus.OK


def refusal(file: Path) -> str:
    """The message with which a file is refused; empty if it is read."""
    try:
        read_portable(file)
    except InputError as error:
        return str(error)
    return ""


@pytest.mark.parametrize(("text", "message"), [
    ("", "Expecting value"), ("[]", "format must be"), ("{", "not a model file"), ('{"format": "x"}', "format must be"),
    ('{"format": "StepGap model", "schema": 6}', "schema must be 5, not 6"), ("[" * 100_000, "not a model file"),
    ('{"format": "StepGap model", "schema": 4}', "schema is 4, that of a former version, and not 5"),
    ('{"format": "StepGap model", "schema": 5}', "not a model file"),
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

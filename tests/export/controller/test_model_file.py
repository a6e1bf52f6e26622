"""The model file: read back, validated, and read by the code of its page."""

import json
import re
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stepgap.base.errors import InputError
from stepgap.export.controller import model_reading
from stepgap.export.controller.model_document import model_document, model_text, trust_at_end
from stepgap.export.controller.model_reading import read_portable
from stepgap.export.controller.portable_controller import PortableController
from stepgap.export.controller.trust_document import SOURCES, trust_from
from stepgap.learning.steps import LoggedStep, Steps
from stepgap.learning.trust import Trust
from stepgap.step import StepSpace, StepStatus
from tests.control.maps import YAW
from tests.export.controller.changing_robot import changing_steps
from tests.export.controller.learned import CENTRE, KINDS, SCALE, SPACE, learned, steps

PAGE = Path(__file__).parents[3] / "docs" / "model_file.md"
READER, ONLINE = re.findall(r"```python\n(.*?)```", PAGE.read_text("utf-8"), re.DOTALL)
"""The blocks of "model_file.md"."""
SCHEMA = json.loads(Path(model_reading.__file__).with_name("model_file.schema.json").read_text("utf-8"))


def reader(controller: PortableController, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> dict[str, Any]:
    """What the code of the page defines, given a model file."""
    monkeypatch.chdir(tmp_path)
    Path("model.json").write_text(model_text(controller), "utf-8")
    names: dict[str, Any] = {}
    exec(compile(READER + ONLINE, "model_file.md", "exec"), names)  # noqa: S102  (our own page)
    return names


@pytest.mark.parametrize("linear", [False, True], ids=["legendre", "affine"])
@pytest.mark.parametrize("kind", KINDS)
def test_forty_lines_of_the_page_compute_the_same_map(kind: str, linear: bool, monkeypatch, tmp_path) -> None:
    controller = learned(kind, linear=linear)
    names, step_map = reader(controller, monkeypatch, tmp_path), controller.map
    for state, command in zip(*steps(40), strict=True):
        point = np.concatenate([state, command])
        mean, std = np.transpose([names["mean_and_std"](part, point) for part in names["regressions"]])
        assert np.abs(names["next_state"](point) + mean - step_map(state, command)).max() < 1e-9
        assert np.abs(std - step_map.std(state, command)).max() < 1e-9


def test_the_reader_has_forty_lines() -> None:
    assert len([line for line in READER.splitlines() if line.strip()]) <= 40


@pytest.mark.parametrize(("kind", "options"), [
    ("gp", {}), ("quadratic", {"reject_outliers": False}), ("gp_on_linear", {"monitor": False}), ("none", {}),
])  # fmt: skip
def test_the_page_trusts_what_python_trusts(kind: str, options: dict[str, bool], monkeypatch, tmp_path) -> None:
    controller = replace(learned(kind), **{"reject_outliers": True, **options})
    names, rng = reader(controller, monkeypatch, tmp_path), np.random.default_rng(3)
    found, expected, alarms = names["start"], controller.trust, set()
    for step in changing_steps(controller):
        record, yaw = step.record, float(rng.uniform(0, 7))
        point = np.concatenate([record.state, record.command])
        inputs = (point - CENTRE) / SCALE
        mean, std = names["disturbance"](found["hypotheses"][0], names["regressors"](point, yaw))
        disturbance = expected.hypotheses[0].filter.predict(yaw, controller.map.noise_std)
        assert np.abs(mean - disturbance.mean(inputs)).max() < 1e-9
        assert np.abs(std - disturbance.std(inputs)).max() < 1e-9
        found = names["after"](found, point, record.next_state, step.phase)
        expected = controller.trust_after(expected, record, step.phase)
        alarms |= {expected.alarm}
        assert [each["source"] for each in found["hypotheses"]] == [each.source for each in expected.hypotheses]
        weights = [each["log_weight"] for each in found["hypotheses"]]
        assert np.allclose(weights, [each.log_weight for each in expected.hypotheses], rtol=0, atol=1e-6)
        assert found["strained"] == expected.strained
    assert {"changed", "earlier"} <= alarms or kind == "none"


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
    assert json.loads(file.read_text("utf-8"))["trust"]["end"] is None


def deployed(tmp_path: Path) -> tuple[Path, Trust]:
    """A model file after a deployment with a step that fell, and the trust at its end."""
    controller = replace(learned("gp"), reject_outliers=True)
    log, expected = [], controller.trust
    robot = changing_steps(controller, (("as learned", 8), ("loaded", 4), ("as learned", 3), ("nominal", 2)))
    for number, (each, following) in enumerate(pairwise(robot)):
        record = replace(each.record, context={"yaw": following.phase})
        if number == 5:
            record = replace(record, next_state=np.full(2, np.nan), status=StepStatus.FELL, context={})
        log.append(LoggedStep(0, number, record.state, record.state, np.zeros(2), record))
        expected = controller.trust_after(expected, record, np.nan if number == 6 else each.phase)
    file, logged = tmp_path / "model.json", Steps(StepSpace(SPACE.state, SPACE.command, (YAW,)), log)
    file.write_text(model_text(controller, trust_at_end(controller, logged)), "utf-8")
    return file, expected


def test_the_trust_at_the_end_of_a_deployment_is_in_the_file(tmp_path: Path) -> None:
    file, expected = deployed(tmp_path)
    document = json.loads(file.read_text("utf-8"))
    jsonschema.validate(document, SCHEMA)
    assert {each.source for each in expected.hypotheses} == set(SOURCES)
    for found in (document["trust"]["end"], model_document(read_portable(file), trust_of(file))["trust"]["end"]):
        for each, hypothesis in zip(found["hypotheses"], expected.hypotheses, strict=True):
            assert each["source"] == hypothesis.source
            assert each["log_weight"] == pytest.approx(hypothesis.log_weight)
            assert (each["changed"], each["corrected"]) == (hypothesis.filter.changed, hypothesis.corrected)
            assert np.allclose(each["coefficients"], hypothesis.filter.coefficients, rtol=0, atol=1e-12)
            assert np.allclose(each["covariance"], hypothesis.filter.covariance, rtol=0, atol=1e-9)


def trust_of(file: Path) -> Trust | None:
    """The trust at the end of the deployment in a file."""
    return trust_from(json.loads(file.read_text("utf-8")), read_portable(file))


@pytest.mark.parametrize(("keys", "value", "message"), [
    (("hypotheses", 0, "source"), "nominal", "one of current, changed, nominal, earlier after the other"),
    (("hypotheses", 0, "source"), "other", "must be one of current, changed, nominal, earlier, not 'other'"),
    (("hypotheses", 0, "coefficients"), [[1.0]], "coefficients must be finite numbers of shape"),
    (("hypotheses", 0, "changed"), 1, "changed"), (("hypotheses",), [], "one of current"),
    (("strained",), -1, "strained"),
])  # fmt: skip
def test_a_wrong_end_is_refused(keys: tuple[Any, ...], value: Any, message: str, tmp_path: Path) -> None:
    file, _ = deployed(tmp_path)
    document = json.loads(file.read_text("utf-8"))
    part = document["trust"]["end"]
    for key in keys[:-1]:
        part = part[key]
    part[keys[-1]] = value
    file.write_text(json.dumps(document), "utf-8")
    with pytest.raises(InputError, match=message):
        read_portable(file)


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
        assert path[0] in ("failures", "state", "command", "nominal", "control", "outliers"), path
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
    ('{"format": "StepGap model", "schema": 4}', "schema must be 3, not 4"), ("[" * 100_000, "not a model file"),
    ('{"format": "StepGap model", "schema": 3}', "not a model file"),
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

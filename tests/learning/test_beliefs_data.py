"""Beliefs in files: what is read is what was written, and whatever is damaged is refused with the name of a key."""

import copy
import json
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stepgap.gauss.features import Features
from stepgap.learning.beliefs import Beliefs
from stepgap.learning.beliefs_data import MOST_READ, beliefs_from_dict, beliefs_to_dict
from tests.learning.robots import FAMILY, SIZES, Robot, begun, changed, drawn, known


def between_deployments() -> Beliefs:
    """Beliefs that know a robot that has changed, before another deployment."""
    robot = Robot(drawn(0), 0)
    beliefs = begun(FAMILY)
    for number in range(30):
        if number == 20:
            robot.weights = changed(robot.weights)
        beliefs = beliefs.after(robot.step())
    return beliefs.redeployed()


BELIEFS = between_deployments()
SAVED = beliefs_to_dict(BELIEFS)


def test_what_is_read_is_what_was_written() -> None:
    restored = beliefs_from_dict(json.loads(json.dumps(SAVED, allow_nan=False)), SIZES)
    assert beliefs_to_dict(restored)["beliefs"] == SAVED["beliefs"]
    assert restored.wrong_measurements == BELIEFS.wrong_measurements
    np.testing.assert_allclose(restored.change, BELIEFS.change, rtol=1e-12, atol=1e-18)
    for one, other in zip(restored.beliefs, BELIEFS.beliefs, strict=True):
        assert (one.kind, one.rate, one.age, one.log_weight) == (other.kind, other.rate, other.age, other.log_weight)
        for name in ("freedom", "squares"):
            np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
        np.testing.assert_array_equal(one.weights.mean, other.weights.mean)
        np.testing.assert_array_equal(one.weights.root, other.weights.root)


def test_they_go_on_as_if_they_had_not_been_in_a_file() -> None:
    restored, robot = beliefs_from_dict(json.loads(json.dumps(SAVED)), SIZES), Robot(drawn(0), 4)
    continued = BELIEFS
    for _ in range(12):
        step = robot.step()
        restored, continued = restored.after(step), continued.after(step)
    for one, other in zip(known(restored), known(continued), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9)


@pytest.mark.parametrize("waves", [0, 3])
def test_features_without_waves_are_read(waves: int) -> None:
    features = Features.drawn(4, 2, waves, 2.0, np.random.default_rng(0))
    beliefs = Beliefs.start(features, SIZES, (), None)
    restored = beliefs_from_dict(json.loads(json.dumps(beliefs_to_dict(beliefs))), SIZES)
    assert restored.features.waves == waves
    assert len(restored.beliefs) == len(beliefs.beliefs)


def test_beliefs_of_another_robot_are_refused() -> None:
    for sizes in ((3, 2), (2, 3), (1, 1)):
        with pytest.raises(ValueError, match=r"change\.shape"):
            beliefs_from_dict(SAVED, sizes)


@pytest.mark.parametrize("key", ["features", "change", "wrong_measurements", "beliefs"])
def test_a_missing_entry_is_named(key: str) -> None:
    with pytest.raises(ValueError, match=key):
        beliefs_from_dict({name: value for name, value in SAVED.items() if name != key}, SIZES)


@pytest.mark.parametrize("key", ["kind", "mean", "root", "freedom", "squares", "log_weight", "rate", "age"])
def test_a_missing_entry_of_a_belief_is_named(key: str) -> None:
    saved = copy.deepcopy(SAVED)
    del saved["beliefs"][1][key]
    with pytest.raises(ValueError, match=key):
        beliefs_from_dict(saved, SIZES)


WRONG: list[tuple[str, object]] = [
    ("kind", "other"),
    ("kind", ["family"]),
    ("kind", {}),
    ("mean", [[0.0]]),
    ("root", [[-1.0] * len(SAVED["beliefs"][0]["root"][0])] * 2),
    ("root", [[0.0] * len(SAVED["beliefs"][0]["root"][0])] * 2),
    ("root", [[1e200] * len(SAVED["beliefs"][0]["root"][0])] * 2),
    ("root", SAVED["beliefs"][0]["root"][:1]),
    ("freedom", [8.0]),
    ("freedom", [8.0, 2.0]),
    ("squares", [0.0, 1.0]),
    ("squares", [1e300, 1.0]),
    ("squares", [1.0, float("nan")]),
    ("log_weight", "large"),
    ("log_weight", float("inf")),
    ("rate", -0.1),
    ("rate", 2),
    ("age", -1),
    ("age", 0.5),
]


@pytest.mark.parametrize(("key", "value"), WRONG, ids=[f"{key}-{number}" for number, (key, _) in enumerate(WRONG)])
def test_a_wrong_entry_of_a_belief_is_named(key: str, value: object) -> None:
    saved = copy.deepcopy(SAVED)
    saved["beliefs"][1][key] = value
    with pytest.raises(ValueError, match=key):
        beliefs_from_dict(saved, SIZES)


def test_beliefs_about_former_times_alone_are_refused() -> None:
    saved = copy.deepcopy(SAVED)
    for each in saved["beliefs"]:
        each["kind"] = "earlier"
    with pytest.raises(ValueError, match="another one than earlier"):
        beliefs_from_dict(saved, SIZES)


@pytest.mark.parametrize("number", [0, MOST_READ + 1])
def test_none_or_too_many_are_refused(number: int) -> None:
    with pytest.raises(ValueError, match="beliefs must be a list of 1 to"):
        beliefs_from_dict({**SAVED, "beliefs": SAVED["beliefs"][:1] * number}, SIZES)


JSON: Any = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=4),
    lambda each: st.lists(each, max_size=3) | st.dictionaries(st.text(max_size=4), each, max_size=3),
    max_leaves=5,
)


@settings(max_examples=150)
@given(st.data())
def test_however_data_are_damaged_they_are_refused_or_can_plan(data: st.DataObject) -> None:
    """Somewhere inside, a value is replaced, taken away, or repeated."""
    saved: Any = copy.deepcopy(SAVED)
    inside = saved
    for _ in range(data.draw(st.integers(0, 4))):
        if not isinstance(inside, dict | list) or not inside:
            break
        outside, keys = inside, list(inside) if isinstance(inside, dict) else range(len(inside))
        key = data.draw(st.sampled_from(keys))
        inside = outside[key]
        how = data.draw(st.sampled_from(["go on", "replace", "remove", "repeat"]))
        if how == "replace":
            outside[key] = data.draw(JSON)
        elif how == "remove":
            del outside[key]
        elif how == "repeat" and isinstance(inside, list):
            outside[key] = inside * 2
        if how != "go on":
            break
    try:
        found = beliefs_from_dict(saved, SIZES)
    except ValueError:
        return
    step = Robot(drawn(0), 1).step()
    mean, std = known(found.redeployed().after(step))
    assert np.isfinite(mean).all()
    assert np.isfinite(std).all()

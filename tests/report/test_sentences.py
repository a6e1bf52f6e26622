"""Sentences on a run claim no more than its numbers support."""

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter

from stepgap.experiment.bands import rmse_interval
from stepgap.experiment.run import Run
from stepgap.learning.steps import LoggedStep, Steps
from stepgap.records.summary import parse_summary
from stepgap.report.sentences import floor_sentences, headline, sentences
from stepgap.step import ContextQuantity, Quantity, StepRecord, StepSpace, StepStatus
from tests.control.maps import LossyHopper
from tests.report.runs import logged


def changed(run: Path, floor: float, **last: Any) -> Run:
    """The run with a noise floor and with other values of its last deployment."""
    content = json.loads((run / "summary.json").read_text())
    content["repeatability"] = dict.fromkeys(("speed", "height"), floor)
    content["iterations"][-1] |= last
    space = LossyHopper().space
    return Run(run, space=space, summary=parse_summary(json.dumps(content), space.state_names, "summary.json"))


def test_an_error_above_three_noise_floors_is_not_called_tracking(hopper_run: Path) -> None:
    small = {"speed": 0.001, "height": 0.001}
    assert headline(changed(hopper_run, 0.001, rmse=small)).startswith("It tracked: the last deployment made all its")
    large = small | {"height": 0.0121}
    found = headline(changed(hopper_run, 0.001, rmse=large))
    assert found.startswith(
        "It did not track: the error of height is 10 % of its range (12 noise floors). But the last"
    )
    close = headline(changed(hopper_run, 0.001, rmse=small | {"height": 0.0031}))
    text = "It followed its targets closely, the error of height is 2.6 % of its range (3.1 noise floors): the last"
    assert close.startswith(text), "a robot with little noise is not blamed for a small error"
    unknown = headline(changed(hopper_run, 0.0, rmse=large))
    assert unknown.startswith("The last deployment made all its 40 steps"), "an unknown noise floor claims nothing"


def test_the_noise_floor_has_its_number_of_steps_and_its_interval(hopper_run: Path, tmp_path: Path) -> None:
    """The ends follow from quantiles of χ² with 60 degrees of freedom in a table: 40.482 and 83.298."""
    freedom = {"repeatability_freedom": {"speed": 60, "height": None}, "repeatability_steps": 240}
    run = shutil.copytree(hopper_run, tmp_path / "run")
    content = json.loads((run / "summary.json").read_text()) | freedom
    (run / "summary.json").write_text(json.dumps(content))
    text = " ".join(floor_sentences(changed(run, 0.01)))
    ends = 0.01 * np.sqrt(60 / 83.298), 0.01 * np.sqrt(60 / 40.482)
    assert f"speed 0.0100 m/s (95 % interval {ends[0]:.5f} to {ends[1]:.4f}), height 0.0100 m, from 240 steps" in text


@pytest.mark.parametrize("memory", [0.0, 0.5])
def test_intervals_contain_the_rmse_about_as_often_as_they_say(memory: float) -> None:
    """Errors of variance 1, independent or with a memory, whose RMSE is 1 on average."""
    rng, runs, count = np.random.default_rng(2), 200, 227
    noise = np.sqrt(1 - memory**2) * rng.normal(size=(runs, count))
    errors = lfilter([1.0], [1.0, -memory], noise, zi=memory * rng.normal(size=(runs, 1)))[0]
    space = StepSpace((Quantity("x", "m", -1, 1),), (Quantity("u", "N", -1, 1),))
    inside = 0
    for row in errors:
        # `logged` makes a step whose next state is 1.1 times its target, so its error is a tenth of the target.
        steps = [logged(0, step, np.zeros(1), np.array([10 * error])) for step, error in enumerate(row, start=1)]
        low, high = rmse_interval(Steps(space, steps))[:, 0]
        inside += low <= 1 <= high
    assert 0.88 <= inside / runs <= 0.99


def test_cut_commands_and_targets_that_were_not_held_are_listed(hopper_run: Path) -> None:
    text = " ".join(sentences(changed(hopper_run, 0.001, cut=7, unreachable=[[0.3, 0.7]], missed=[[0.1, 0.6]] * 8)))
    assert "Limits cut 7 of 40 commands of deployment 2" in text
    held = "Not held by any command within the bounds, by the"
    assert f"{held} map of deployment 2: 1 target (speed 0.3 m/s, height 0.7 m)." in text
    assert f"{held} nominal map" not in text
    assert "although its map holds them: 8 targets (speed 0.1 m/s, height 0.6 m; " in text
    assert "; and 2 more)" in text
    text = " ".join(sentences(changed(hopper_run, 0.001, cut=0, unreachable=[], missed=[])))
    assert not any(word in text for word in ("cut", "Not held", "Missed"))


def test_the_ground_above_which_heights_are_measured_is_named(tmp_path: Path) -> None:
    space = StepSpace(
        (Quantity("speed", "m/s", 0, 1), Quantity("height", "m", 0, 1, above="ground")),
        (Quantity("force", "N", 0, 1),),
        (ContextQuantity("ground", "m"),),
    )
    state, command, nothing = np.array([0.1, 0.5]), np.array([0.5]), np.zeros(2)
    steps = [
        LoggedStep(0, number, nothing, nothing, nothing, record)
        for number, context in enumerate(({"ground": 0.01}, {"ground": -0.03}, {}, {"ground": 0.02}), 1)
        for record in [StepRecord(state, command, command, state, StepStatus.OK, context)]
    ]
    run = Run(tmp_path, space=space, recorded=Steps(space, steps))
    assert sentences(run)[0] == (
        "Height is measured above the ground that each step found, which lay between −0.030 and 0.020 m and changed by "
        "up to 0.040 m from a step to the next."
    )

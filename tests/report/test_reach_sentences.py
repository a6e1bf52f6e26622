"""What a report says of targets and commands does not contradict itself, for robots whose commands are known."""

import re
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from stepgap.control.reach import CommandEffect
from stepgap.control.reference import Reference
from stepgap.experiment.loop import Plants, Setup, run_experiment
from stepgap.experiment.run import Run
from stepgap.learning.settings import LearningSettings
from stepgap.plants.model_plant import ModelPlant
from stepgap.report.gait_text import effect_sentences
from stepgap.step import Array
from tests.control.maps import LossyHopper
from tests.control.test_reach import Linear
from tests.report.pages import Page
from tests.report.runs import TARGETS, report_of

NEAR_LINE = np.array([[0.2, 0.1], [0.4, 0.2], [0.4, 0.21], [0.4, 0.4], [-0.2, 0.1], [0.0, 0.3]])
"""Targets of a robot whose one command moves both coordinates, by 1 and 0.5: some are held, at least up to noise."""


def test_summary_gait_and_diagnosis_agree(tmp_path: Path) -> None:
    nominal = Linear(((0.0, 0.0), (0.0, 0.0)), ((1.0,), (0.5,)))
    real = Linear(((0.1, 0.0), (0.0, 0.1)), ((0.9,), (0.45,)))
    reference = Reference(("x0", "x1"), np.repeat(NEAR_LINE, 12, axis=0))
    plant = partial(ModelPlant, real, np.zeros(2), np.full(2, 0.01))
    run_experiment(Setup(nominal, Plants(plant), reference, LearningSettings(iterations=1)), tmp_path)
    page = Page(report_of(tmp_path, space=nominal.space, nominal=nominal)).text
    last = Run(tmp_path, space=nominal.space).deployments[-1]
    assert 0 < len(last.unreachable) < len(NEAR_LINE)
    held = len(NEAR_LINE) - len(last.unreachable)
    assert f"Corrected map: {held} of {len(NEAR_LINE)} targets are held" in page
    assert f"by the map of deployment 1: {len(last.unreachable)} targets (x0" in page
    first = Run(tmp_path, space=nominal.space).deployments[0]
    assert f"Nominal map: {len(NEAR_LINE) - len(first.unreachable)} of {len(NEAR_LINE)} targets are held" in page
    assert "the commands move the next state in 1 independent direction " in page
    assert "one step does not reach every combination of x0 and x1, even if it reaches each one" in page
    found = re.search(r"one step can make (none|\d+) of the (\d+) changes of the target, for example not that", page)
    assert found is not None
    assert found[2] == "5"
    assert 0 < int(found[1]) < 5


def test_a_delay_and_a_coordinate_that_no_command_moves_are_named() -> None:
    def said(delays: list[int]) -> list[str]:
        effect = CommandEffect(np.ones(2), np.array(delays))
        return effect_sentences(LossyHopper().space, effect, "the map", "bands")[1:]

    assert said([1, 1]) == []
    assert said([1, 2]) == ["By the map, height moves only 2 steps after a command begins."]
    assert said([0, 1]) == ["By the map, no command moves speed within 2 steps."]
    assert said([0, 0]) == ["By the map, no command moves speed or height within 2 steps."]


class Low(LossyHopper):
    """A hopper that only bounces 0.3 m below every target; its command moves the height by 2 cm."""

    def next_state(self, state: Array, command: Array) -> Array:
        found = super().next_state(state, command)
        found[..., 1] = 0.28 + 0.001 * command[..., 1]
        return found


@pytest.mark.usefixtures("drawn_page", "unplaced")
def test_a_robot_that_stays_below_every_target_gets_a_diagnosis(tmp_path: Path) -> None:
    plant = partial(ModelPlant, Low(), TARGETS.targets[0], np.array([0.004, 0.001]))
    done = run_experiment(Setup(LossyHopper(), Plants(plant), TARGETS, LearningSettings()), tmp_path)
    assert len(done) == 3
    page = Page(report_of(tmp_path, space=Low().space, nominal=LossyHopper())).text
    assert page.startswith("\nStepGap report")
    assert "It did not track" in page
    below = re.findall(r"In all 40 steps of deployment 2, height ended below all targets, (0\.\d+) to (0\.\d+) m", page)
    assert len(below) == 1, "on the first screen, and not again in the diagnosis"
    assert 0.2 < float(below[0][0]) < float(below[0][1]) < 0.4
    assert "further redeployments would hardly help" in page
    assert "fy was at a bound" in page
    assert "Corrected map: 0 of 4 targets are held" in page
    assert re.search("one step can make (none|1) of the 3 changes", page), "it has not been where they begin"

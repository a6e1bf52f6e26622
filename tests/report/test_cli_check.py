"""`stepgap check`: what it says of robots that are in order, and of robots with one wrong part."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from stepgap.control.reference import Reference
from stepgap.experiment.settings import read_experiment
from stepgap.plants.ticks.tick_table import TickTable
from stepgap.report.cli.check import results_of_robot
from stepgap.report.map_check import check_map
from stepgap.report.robot_check import (
    PartResult,
    check_commands,
    check_placing,
    check_section,
    check_targets,
    results_of,
)
from stepgap.robots.entry_points import load_robot
from stepgap.robots.robot import Robot, stairs
from stepgap.step import Array, Quantity, StepSpace
from tests.cli.command_line import Command, CommandResult, refused
from tests.control.maps import FX, FY, HEIGHT, SPEED, LossyHopper, NeverWorks
from tests.robots.plug_in import CUSTOM_TOML, TEMPLATE_TOML


def verdicts(result: CommandResult) -> dict[str, str]:
    """Verdicts by part, from the table."""
    rows = [line for line in result.out.splitlines() if line[:1].isalpha() and len(line) > 20]
    return {row[:10].strip(): row[10:20].strip() for row in rows}


@pytest.mark.usefixtures("package", "no_repeats")
def test_a_mujoco_robot_has_every_part(stepgap: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("stepgap.robots.nominal_maps.surrogate_map.MOST_SAMPLES", 256)
    result = stepgap("check", "spring_hopper", "--out", "steps.svg")
    assert result.code == 0, result
    of_map = ["map", "jacobian", "smooth", "targets", "commands", "authority"]
    of_motion = ["motion", "ranges", "gap", "response", "memory", "noise", "section"]
    assert list(verdicts(result)) == ["placing", *of_map, *of_motion]
    assert "surrogate of 256 simulated steps, 0% of which failed" in " ".join(result.out.split())
    assert "kept: --nominal.file nominal_map.json" in result.err
    picture = Path("steps.svg").read_text()
    assert "Along the track" in picture
    refused(stepgap("check", "spring_hopper", "--out", "steps.svg"), "steps.svg: exists already; choose another --out")


@pytest.mark.usefixtures("package", "no_repeats")
def test_a_part_is_known_before_the_next_one_is_tested(stepgap: Command) -> None:
    """So a slow map is no silence: the robot has made no step while the parts of its map are there to be read."""
    settings = read_experiment(None, [("robot", "ball")])
    results = results_of_robot(settings, None, [])
    first = [next(results).part for _ in range(4)]
    assert first == ["placing", "map", "jacobian", "smooth"]
    assert not Path("check.png").exists()
    assert [result.part for result in results][-1] == "section"
    assert Path("check.png").exists()


@pytest.mark.usefixtures("package", "no_repeats")
def test_targets_that_are_not_held_are_wrong_and_the_new_ones_are_right(stepgap: Command) -> None:
    Path("far.csv").write_text("height\n0.6\n40\n")
    result = stepgap("check", "ball", "--reference", "far.csv")
    assert (result.code, verdicts(result)["targets"], verdicts(result)["motion"]) == (1, "wrong", "ok")
    assert "no command holds 1 of the 2 targets" in " ".join(result.out.split())
    message = stepgap("run", "--robot", "ball", "--reference", "far.csv").err
    assert "out of reach" in message
    assert "`stepgap check` proposes targets" in message
    assert stepgap("check", "ball", "--reference", "held_reference.csv").code == 0
    assert sorted(path.name for path in Path().glob("check*.png")) == ["check.png", "check_2.png"]


def test_a_robot_that_does_not_move_here_is_tested_as_far_as_it_can_be(stepgap: Command) -> None:
    Path("experiment.toml").write_text(CUSTOM_TOML)
    Path("template.toml").write_text(TEMPLATE_TOML)
    result = stepgap("check", "experiment.toml")
    assert result.code == 0, result
    found = verdicts(result)
    assert (found["placing"], found["map"], found["motion"]) == ("left out", "ok", "left out")
    assert "Give the program of the robot after two dashes" in " ".join(result.out.split())
    Path("template.toml").unlink()
    result = stepgap("check", "experiment.toml")
    assert (result.code, verdicts(result)["map"]) == (1, "wrong")
    assert "template.toml" in result.out


def test_a_robot_is_named_once(stepgap: Command) -> None:
    refused(stepgap("check", "hoper"), "robot 'hoper'", "did you mean hopper?")
    refused(stepgap("check", "hopper", "--robot", "quadruped"), "give the name of the robot only once")


@dataclass(frozen=True)
class Slipping(Robot):
    """A robot whose model forgets a part of the height."""

    name = "slipping"

    @property
    def space(self) -> StepSpace:
        return LossyHopper().space

    def placed(self, state: Array) -> Array:
        return state * [1.0, 0.9]


def verdict(found: Any) -> tuple[str, str]:
    (only,) = found
    return only.verdict, only.sentence


def test_a_model_that_is_placed_elsewhere_is_wrong() -> None:
    kind, sentence = verdict(check_placing(Slipping(), 0))
    assert kind == "wrong"
    assert "another state: height by up to 1" in sentence
    assert verdict(check_placing(load_robot("quadruped"), 0))[0] == "ok"
    assert verdict(check_placing(load_robot("hopper"), 0))[0] == "left out"


def test_a_map_without_steps_and_commands_without_effect_are_wrong() -> None:
    step_map = LossyHopper()
    reference = stairs(step_map.space)
    assert verdict(check_map(step_map, np.random.default_rng(0)))[0] == "ok"
    assert verdict(check_map(NeverWorks(), np.random.default_rng(0)))[0] == "wrong"
    assert verdict(check_commands(step_map, reference))[0] == "ok"
    dead = LossyHopper(push=0.0)
    kind, sentence = verdict(check_commands(dead, reference))
    assert kind == "wrong"
    assert "no command moves speed within 2 steps" in sentence
    far = replace(reference, targets=reference.targets + np.array([0.0, 50.0]))
    assert verdict(check_targets(step_map, far, False, None))[0] == "wrong"
    assert "--reference x.csv" in verdict(check_targets(step_map, far, True, Path("x.csv")))[1]


@pytest.mark.parametrize(
    ("durations", "kind", "text"),
    [
        ([0.7, 0.8, 0.75], "ok", "0.7 to 0.8 s"),
        ([0.7, 0.1, 0.7], "wrong", "too early"),
        ([0.7, 3, 0.7], "wrong", "missed"),
    ],
)
def test_steps_of_very_different_durations_are_wrong(durations: list[float], kind: str, text: str) -> None:
    ends = np.cumsum([0.2, *durations])
    time = np.arange(0.0, ends[-1], 0.01)
    ticks = TickTable({"time": "s", "step": ""}, np.column_stack([time, np.searchsorted(ends, time, side="right")]))
    found = verdict(check_section(ticks))
    assert found[0] == kind
    assert text in found[1]
    assert verdict(check_section(None))[0] == "left out"


def test_an_explained_error_is_a_result() -> None:
    space = StepSpace((SPEED, HEIGHT, Quantity("lean", "rad", -1, 1)), (FX, FY))
    reference = Reference(space.state_names, np.array([[0.2, 0.58, 0.0]]))
    (found,) = results_of(
        "commands", check_commands(NeverWorks(), Reference(("speed", "height"), reference.targets[:, :2]))
    )
    assert isinstance(found, PartResult)
    assert found.verdict == "wrong"


@pytest.mark.usefixtures("package", "no_repeats")
def test_a_machine_that_must_not_get_random_commands_gets_none(
    stepgap: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delattr("stepgap.experiment.trial.ProbedPlant")
    result = stepgap("check", "ball", "--no-random")
    assert (result.code, verdicts(result)["motion"]) == (0, "ok")

"""`stepgap check` names each planted fault by its reason, and finds none in healthy robots."""

import re
from pathlib import Path

import numpy as np
import pytest

from stepgap.report.cli.check import results_of_robot
from stepgap.report.robot_check import PartResult
from tests.report.healthy import random_healthy
from tests.report.toy_robots import (
    Batched,
    Careless,
    Falling,
    Infinite,
    Jumping,
    Remembering,
    Restless,
    Toy,
    ToyMap,
    WithIdle,
    WrongJacobian,
    added,
    commanded,
    dead_band,
    experiment_of,
    first_late,
    hysteresis,
    late,
    legs,
    spring,
)

REAL = ToyMap(keep=0.65, push=0.022, lift=0.0027)
"""What healthy robots differ by from the map."""

FAULTS: dict[str, tuple[Toy, str, str]] = {
    "one derivative has the wrong sign": (Toy(WrongJacobian()), "jacobian", "height/∂fy .* sign is wrong"),
    "the map jumps": (Toy(Jumping()), "smooth", "height jumps by 0.2 half ranges from speed 0.47"),
    "the robot jumps": (Toy(real=Jumping(jump=0.03)), "response", "height jumps by 0.[23].* speed passes about 0.4"),
    "a command is weaker by four": (Toy(law=commanded(lambda u: u * [0.25, 1])), "response", "Fx acts on speed 0.2"),
    "a spring is not measured": (Toy(law=added(spring)), "memory", "error of height .* not measured"),
    "a command has no effect": (Toy(law=commanded(lambda u: u * [0, 1])), "response", "Fx has no effect on speed"),
    "an output is mirrored": (Toy(measured=lambda x: x * [-1, 1]), "response", "Speed is measured with the opp"),
    "a command has the wrong sign": (
        Toy(law=commanded(lambda u: u * [1, -1])),
        "response",
        "Fy acts on speed and height with the opposite sign; reverse",
    ),
    "a command is three times as strong": (
        Toy(real=ToyMap(), law=commanded(lambda u: u * [3, 1])),
        "response",
        "Fx acts on speed and height (2.9|3) times",
    ),
    "commands are exchanged": (Toy(law=commanded(lambda u: u[::-1])), "response", "commands fx and fy are exchanged"),
    "height in centimetres": (Toy(measured=lambda x: x * [1, 100]), "response", "Height is measured in cm inst"),
    "the map is random": (Toy(Restless()), "map", "not deterministic"),
    "commands are late by one step": (Toy(law=late(1)), "response", "Fx and fy act one step too late"),
    "commands are late by two steps": (Toy(law=late(2)), "response", "Fx and fy act 2 steps too late"),
    "the map makes no step": (Toy(Falling()), "map", "no step .fell.. Nor does it anywhere"),
    "the map has no number": (Toy(Infinite()), "map", "have status OK, but no finite height"),
    "by the map a command moves nothing": (Toy(WithIdle()), "authority", "stiffness moves no state"),
    "a robot of noise": (Toy(noise=0.8), "noise", "hardly says how the next step ends"),
    "a constant is missing": (
        Toy(real=REAL, law=added(lambda memory, command, rng: [0, 0.15])),
        "gap",
        r"height ends \+1.[56] half ranges from where the map says: correct the zero",
    ),
    "states are exchanged": (Toy(measured=lambda x: x[::-1]), "response", "Speed and height are exchanged"),
    # Ten more.
    "one derivative is missing": (Toy(WrongJacobian(entry=(0, 3), factor=0.0)), "jacobian", "speed/∂fy .* is missing"),
    "one derivative is twice as large": (Toy(WrongJacobian(entry=(0, 0), factor=2.0)), "jacobian", "2 times as large"),
    "the map remembers": (Toy(Remembering()), "map", "memory of earlier calls"),
    "the map changes its arguments": (Toy(Careless()), "map", "changes the arrays that it is given"),
    "the map mixes up steps": (Toy(Batched()), "map", "mixes up steps"),
    "speed in km/h": (Toy(real=ToyMap(), measured=lambda x: x * [3.6, 1]), "response", "measured in km/h inst"),
    "two legs differ": (Toy(law=added(legs)), "memory", "error of height .* which leg stands"),
    "a sensor stands still": (Toy(measured=lambda x: np.array([0.4, x[1]])), "response", "Speed is the same after all"),
    "a reversed and stronger command": (
        Toy(real=ToyMap(), law=commanded(lambda u: u * [-2, 1])),
        "response",
        "Fx acts on .* with the opposite sign, (1.9|2) times",
    ),
    "one command is late": (
        Toy(law=first_late),
        "response",
        "acts? one step too late",
    ),
}


@pytest.fixture(autouse=True)
def _quick(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("stepgap.report.drawing.write_picture", lambda path, make: None)
    if "noise" not in request.node.name:
        request.getfixturevalue("no_repeats")


def wrong_parts(toy: Toy, seed: int = 0) -> list[PartResult]:
    return [result for result in results_of_robot(experiment_of(toy, seed), None, []) if result.verdict == "wrong"]


@pytest.mark.parametrize("name", FAULTS)
def test_a_planted_fault_is_named_and_all_else_is_its_consequence(name: str) -> None:
    toy, part, reason = FAULTS[name]
    wrong = wrong_parts(toy)
    named = [result for result in wrong if result.part == part]
    assert len(named) == 1, wrong
    assert re.search(reason, named[0].sentence), named
    assert all(f"First mend what is wrong under `{part}`." in one.sentence for one in wrong if one.part != part)


@pytest.mark.parametrize("seed", range(12))
def test_a_healthy_robot_has_no_finding(seed: int) -> None:
    assert wrong_parts(random_healthy(seed), seed) == []


@pytest.mark.parametrize(
    "toy",
    [
        Toy(real=REAL),
        Toy(real=REAL, noise=0.15),
        Toy(real=REAL, law=commanded(dead_band(2.0))),
        Toy(real=REAL, law=hysteresis(2.0)),
        Toy(real=ToyMap(push=0.0175, couple=1.5, bend=1e-4), noise=0.0),
    ],
)
def test_gaps_that_a_run_learns_are_no_finding(toy: Toy) -> None:
    assert wrong_parts(toy) == []

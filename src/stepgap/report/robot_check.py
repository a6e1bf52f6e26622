"""What can be tested of a robot before it moves: its nominal map, targets, commands, and the placing of its model."""

from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np

from stepgap.base.random_streams import random_stream
from stepgap.control.limit_cycle import fixed_point
from stepgap.control.reach import SMALL_PART, command_effect
from stepgap.control.reference import Reference
from stepgap.experiment.nominal import check_surrogate
from stepgap.experiment.outcome import unheld_steps
from stepgap.records.text import in_words
from stepgap.report.part_results import PartResult, half_ranges
from stepgap.report.reach_sentences import effect_sentences
from stepgap.robots.nominal_maps.surrogate_map import SurrogateMap
from stepgap.robots.robot import Robot
from stepgap.step import StepFailed, StepMap, StepStatus

PLACED_STATES: Final = 20  # Number of states into which a model is put

PLACED_ERROR: Final = 0.01
"""Largest difference between a state and the one into which the model was put [half ranges]."""


def check_map(nominal: StepMap) -> Iterator[PartResult]:
    """Whether a surrogate predicts enough, and whether the map makes a step from the middle of the ranges."""
    space = nominal.space
    text = ""
    if isinstance(nominal, SurrogateMap):
        check_surrogate(nominal)
        status = nominal.samples.status
        text = (
            f" The surrogate of {len(status)} simulated steps, {np.mean(status != StepStatus.OK):.0%} of which failed, "
            f"misses the next state by {half_ranges(space, nominal.error / space.state_scale)} half ranges."
        )
    try:
        nominal(space.state_centre, space.command_centre)
    except StepFailed as error:
        advice = "Choose ranges about a motion of the robot."
        yield PartResult("map", "wrong", f"From the middle of all ranges it makes no step: {error}. {advice}{text}")
    else:
        yield PartResult("map", "ok", f"From the middle of all ranges it makes a step.{text}")


def check_targets(nominal: StepMap, reference: Reference, held: bool, file: Path | None) -> Iterator[PartResult]:
    """Whether the map holds the targets of a reference.

    Args:
        nominal: The map.
        reference: The reference.
        held: Whether it has a `held_reference`.
        file: File of that; None if it could not be written.
    """
    missed = len(unheld_steps(nominal, reference))
    count = len(reference.distinct[0])
    if not missed:
        yield PartResult("targets", "ok", f"By the map, a command holds each of the {count} targets of the reference.")
        return
    found = f"By the map, no command holds {missed} of the {count} targets of the reference"
    if not held:
        advice = "Choose ranges about a motion that the robot repeats, or wider bounds of the commands."
        yield PartResult("targets", "wrong", f"{found}, or a state near one of them. {advice}")
    else:
        where = f": --reference {file}" if file else " were found, but could not be written into this folder."
        yield PartResult("targets", "wrong", f"{found}. Held states near them{where}")


def check_commands(nominal: StepMap, held: Reference) -> Iterator[PartResult]:
    """Whether the commands move what is tracked, by the map at the first target.

    Args:
        nominal: The map.
        held: Targets that are held.
    """
    space = nominal.space
    point = fixed_point(nominal, held.targets[0])
    jacobian = nominal.jacobian(point.state, point.command)
    if not np.isfinite(jacobian).all():
        yield PartResult(
            "commands", "left out", "A step near the first target fails, so the map has no derivative there."
        )
        return
    effect = command_effect(space, jacobian, SMALL_PART * space.state_scale)
    sentences = effect_sentences(space, effect, "the map", "hundredths of half the ranges of use")
    stable = "stable" if point.stable else "not stable"
    where = f"{in_words(space.state, point.state)} is held by {in_words(space.command, point.command)}"
    still = bool((effect.delays[space.tracked] == 0).any())
    advice = " Widen the bounds of the commands, or give what none of them moves the weight 0." if still else ""
    yield PartResult(
        "commands",
        "wrong" if still else "ok",
        f"{' '.join(sentences)}{advice} {where}, which is {stable} at a constant command.",
    )


def check_placing(robot: Robot, seed: int) -> Iterator[PartResult]:
    """Whether a model that was put into a state is in this state."""
    space = robot.space
    rng = random_stream(seed, 0, 4)
    states = space.state_centre + space.state_scale * rng.uniform(-1, 1, (PLACED_STATES, len(space.state)))
    found = [robot.placed(state) for state in states]
    if any(each is None for each in found):
        yield PartResult("placing", "left out", "The robot has no model that is put into a state.")
        return
    error = np.max(np.abs(np.array(found) - states), axis=0) / space.state_scale
    wrong = ~(error <= PLACED_ERROR)
    if wrong.any():
        names = [f"{name} by up to {each:.2g}" for name, each in zip(space.state_names, error, strict=True)]
        parts = ", ".join(name for name, is_wrong in zip(names, wrong, strict=True) if is_wrong)
        yield PartResult(
            "placing",
            "wrong",
            f"After `place`, `state` returns another state: {parts} half ranges. Correct one of the two, or leave out "
            "of the state what `place` cannot choose.",
        )
    else:
        yield PartResult("placing", "ok", f"In {PLACED_STATES} random states, `state` returns what `place` was given.")

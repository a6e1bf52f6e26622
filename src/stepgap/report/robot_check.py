"""What can be tested of a robot before its first run: its parts at rest, and what some simulated steps show.

At rest there are its nominal map, targets, commands, and the placing of its model. The steps show failures, sections,
ranges, the gap and the noise.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal

import numpy as np

from stepgap.base.errors import StepGapError
from stepgap.base.random_streams import random_stream
from stepgap.control.limit_cycle import fixed_point
from stepgap.control.reach import SMALL_PART, command_effect
from stepgap.control.reference import Reference
from stepgap.experiment.inputs import TRIAL_STEPS
from stepgap.experiment.nominal import check_surrogate
from stepgap.experiment.outcome import unheld_steps
from stepgap.experiment.run import Run
from stepgap.learning.steps import Steps
from stepgap.plants.ticks.tick_table import TickTable
from stepgap.records.text import capitalised, in_words, unit_suffix
from stepgap.report.diagnosis_sentences import response_sentences
from stepgap.report.gait_text import effect_sentences
from stepgap.robots.nominal_maps.surrogate_map import SurrogateMap
from stepgap.robots.robot import Robot
from stepgap.step import Array, StepFailed, StepMap, StepSpace, StepStatus

Verdict = Literal["ok", "wrong", "left out"]
"""Result of the test of a part."""


@dataclass(frozen=True)
class PartResult:
    """The result of the test of one part of a robot.

    Attributes:
        part: The part.
        verdict: The result.
        sentence: What was found and, if it is wrong, what to do.
    """

    part: str
    verdict: Verdict
    sentence: str


def results_of(part: str, results: Iterator[PartResult]) -> list[PartResult]:
    """The results for a part; an explained error ends them with one more, which is wrong."""
    found = list[PartResult]()
    try:
        found.extend(results)
    except StepGapError as error:
        found.append(PartResult(part, "wrong", f"{capitalised(str(error))}."))
    return found


def half_ranges(space: StepSpace, values: Array) -> str:
    """A number of half ranges for each state coordinate as text."""
    return ", ".join(f"{name} {value:.2g}" for name, value in zip(space.state_names, values, strict=True))


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


UNEVEN: Final = 3.0
"""A step is too short or too long if its duration differs from the median by more than this factor."""

NOISY: Final = 0.5  # Noise of a step from which on it hides the state [half ranges]
MOSTLY: Final = 0.5  # Part of the states that are outside a range of use from which on the range is wrong


def check_motion(run: Run) -> Iterator[PartResult]:
    """Whether the robot steps, and where its states are."""
    steps = run.steps
    done = steps.completed()
    if len(done) < len(steps):
        status = StepStatus(int(steps.status[-1]))
        text = f"Step {len(steps)} failed ({status.label}): {steps.space.advice_on(status)}."
        yield PartResult("motion", "wrong" if len(done) < TRIAL_STEPS else "ok", text)
    else:
        yield PartResult("motion", "ok", f"The robot made {len(steps)} steps without a failure.")
    if len(done):
        yield _ranges(done)
        error = np.sqrt(np.nanmean((done.next_state - done.predicted) ** 2, axis=0)) / run.space.state_scale
        text = f"The map misses the next state by {half_ranges(run.space, error)} half ranges; a run learns this."
        yield PartResult("gap", "ok", text)
        found = response_sentences(steps, run.needed(run.nominal))
        text = " ".join(found) or "The steps do not contradict the effect of the commands that the map expects."
        yield PartResult("response", "wrong" if found else "ok", text)


def _ranges(steps: Steps) -> PartResult:
    """Where the visited states are in their ranges of use."""
    space = steps.space
    states = np.concatenate([steps.state[:1], steps.next_state])
    outside = np.mean((states < space.state_lower) | (states > space.state_upper), axis=0)
    visited = [
        f"{quantity.name} {low:.3g} to {high:.3g}{unit_suffix(quantity)}"
        for quantity, low, high in zip(space.state, states.min(axis=0), states.max(axis=0), strict=True)
    ]
    if wrong := [visited[row] for row in np.flatnonzero(outside > MOSTLY)]:
        advice = "check the units, and choose the ranges about the states that the robot visits"
        return PartResult("ranges", "wrong", f"Mostly outside the range of use: {', '.join(wrong)}; {advice}.")
    return PartResult("ranges", "ok", f"The robot visited {', '.join(visited)}.")


def check_section(ticks: TickTable | None) -> Iterator[PartResult]:
    """Whether the steps take about equally long.

    Args:
        ticks: Ticks of a deployment with columns `time` and `step`; None if they are not known.
    """
    if ticks is None:
        yield PartResult("section", "left out", "The plant reports no ticks, so it is not known how long a step takes.")
        return
    ends = np.append(np.flatnonzero(np.diff(ticks["step"]) > 0), len(ticks) - 1)
    duration = np.diff(ticks["time"][ends])
    if not len(duration):
        yield PartResult("section", "left out", "There is no step whose duration is known.")
        return
    middle = float(np.median(duration))
    text = f"A step takes {duration.min():.2g} to {duration.max():.2g} s"
    if duration.min() < middle / UNEVEN:
        yield PartResult(
            "section", "wrong", f"{text}: a section was found too early. Raise the threshold of the section."
        )
    elif duration.max() > middle * UNEVEN:
        yield PartResult("section", "wrong", f"{text}: a section was missed. Lower the threshold of the section.")
    else:
        yield PartResult("section", "ok", f"{text}.")


def check_noise(run: Run) -> Iterator[PartResult]:
    """Whether a repeated step ends alike."""
    noise = run.noise_floor / run.space.state_scale
    if not (np.isfinite(noise).any() and run.summary.noise_floor_measured):
        yield PartResult("noise", "left out", "The plant cannot repeat a step, or each repeated step failed.")
        return
    text = f"A repeated step varies by {half_ranges(run.space, noise)} half ranges"
    if np.nanmax(noise) > NOISY:
        advice = "Find what varies and make it a state, or choose another section."
        yield PartResult("noise", "wrong", f"{text}, so the state hardly says how the next step ends. {advice}")
    else:
        yield PartResult("noise", "ok", f"{text}.")

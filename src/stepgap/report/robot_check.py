"""What can be tested of a robot before its first run: its parts at rest, and what some simulated steps show.

At rest there are its nominal map, targets, commands, and the placing of its model. The steps show failures, sections,
ranges, the gap and the noise.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from stepgap.base.errors import StepGapError
from stepgap.base.random_streams import random_stream
from stepgap.control.limit_cycle import fixed_point
from stepgap.control.reach import SMALL_PART, command_effect
from stepgap.control.reference import Reference
from stepgap.experiment.inputs import TRIAL_STEPS
from stepgap.experiment.outcome import unheld_steps
from stepgap.experiment.run import Run
from stepgap.learning.steps import Steps, joined
from stepgap.plants.ticks.tick_table import TickTable
from stepgap.records.text import capitalised, in_words, listed, unit_suffix
from stepgap.report.gait_text import HALF_RANGES, effect_sentences
from stepgap.report.robot_response import (
    LEAST_REMEMBERED,
    REMEMBERED,
    break_of,
    causes,
    contradictions,
    frozen_states,
    measured_derivatives,
    unmeasured_state,
)
from stepgap.robots.robot import Robot
from stepgap.step import Array, StepMap, StepSpace, StepStatus

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
    collected = list[PartResult]()
    try:
        collected.extend(results)
    except StepGapError as error:
        collected.append(PartResult(part, "wrong", f"{capitalised(str(error))}."))
    return collected


def half_ranges(space: StepSpace, values: Array) -> str:
    """A number of half ranges for each state coordinate as text."""
    return ", ".join(f"{name} {value:.2g}" for name, value in zip(space.state_names, values, strict=True))


PLACED_STATES: Final = 20  # Number of states into which a model is put

PLACED_ERROR: Final = 0.01
"""Largest difference between a state and the one into which the model was put [half ranges]."""


def check_targets(nominal: StepMap, reference: Reference, held: bool, file: Path | None) -> Iterator[PartResult]:
    """Whether the map holds the targets of a reference.

    Args:
        held: Whether it has a `held_reference`.
        file: File of that; None if it could not be written.
    """
    missed = len(unheld_steps(nominal, reference))
    count = len(reference.distinct[0])
    if not missed:
        yield PartResult("targets", "ok", f"By the map, a command holds each of the {count} targets of the reference.")
        return
    fault = f"By the map, no command holds {missed} of the {count} targets of the reference"
    if not held:
        advice = "Choose ranges about a motion that the robot repeats, or wider bounds of the commands."
        yield PartResult("targets", "wrong", f"{fault}, or a state near one of them. {advice}")
    else:
        where = f": --reference {file}" if file else " were found, but could not be written into this folder."
        yield PartResult("targets", "wrong", f"{fault}. Held states near them{where}")


def check_commands(nominal: StepMap, held: Reference) -> Iterator[PartResult]:
    """Whether the commands move what is tracked, by the map at the first target."""
    space = nominal.space
    point = fixed_point(nominal, held.targets[0])
    jacobian = nominal.jacobian(point.state, point.command)
    if not np.isfinite(jacobian).all():
        text = "A step near the first target fails, so the map has no derivative there."
        yield PartResult("commands", "left out", text)
        return
    effect = command_effect(space, jacobian, SMALL_PART * space.state_scale)
    sentences = effect_sentences(space, effect, "the map", HALF_RANGES)
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
    placed = [robot.placed(state) for state in states]
    if any(state is None for state in placed):
        yield PartResult("placing", "left out", "The robot has no model that is put into a state.")
        return
    error = np.max(np.abs(np.array(placed) - states), axis=0) / space.state_scale
    wrong = ~(error <= PLACED_ERROR)
    if wrong.any():
        sizes = zip(space.state_names, error, wrong, strict=True)
        parts = ", ".join(f"{name} by up to {size:.2g}" for name, size, is_wrong in sizes if is_wrong)
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

_NOISY: Final = 0.5  # Noise of a step from which on it hides the state [half ranges]
_OFTEN_OUTSIDE: Final = 0.25  # Part of the states of a trial outside a range of use from which on it is a finding
_OUTSIDE: Final = 0.1  # Part of the states outside, where the map predicts them, too, from which on it is one
_FEW_OUTSIDE: Final = 2  # Number of states outside that is no finding
_LARGE_GAP: Final = 1.0  # Error from which on the map predicts no better than the middle of the range [half ranges]


def check_robot_steps(run: Run, probes: Steps) -> Iterator[PartResult]:
    """Whether the robot steps, where its states are, and whether it steps as the map says.

    What to do follows from what is found: a cause takes the place of the advice on a symptom.

    Args:
        probes: Steps whose commands vary at random.
    """
    nominal = run.needed(run.nominal)
    steps = joined([run.steps, probes]) if len(probes) else run.steps
    response = list(_response(steps, nominal, run.noise_floor / run.space.state_scale))
    noise = _noise(run, _first(response))
    gap = _gap(run.steps, nominal, _first([*response, noise]))
    first = _first([*response, noise, gap])
    yield from (_motion(run, first), _ranges(run, steps, first), gap, *response, noise)


def _first(results: Sequence[PartResult]) -> str:
    """What to mend first, if one of some results is wrong; else empty."""
    return next((f"First mend what is wrong under `{one.part}`." for one in results if one.verdict == "wrong"), "")


def _motion(run: Run, cause: str) -> PartResult:
    """Whether the robot made its steps."""
    steps = run.steps
    done = steps.completed()
    if len(done) == len(steps):
        return PartResult("motion", "ok", f"The robot made {len(steps)} steps without a failure.")
    status = StepStatus(int(steps.status[-1]))
    text = f"Step {len(steps)} failed ({status.label}): {cause or capitalised(steps.space.advice_on(status)) + '.'}"
    return PartResult("motion", "wrong" if len(done) < TRIAL_STEPS else "ok", text)


def _ranges(run: Run, steps: Steps, cause: str) -> PartResult:
    """Where the visited states are in their ranges of use.

    That states are outside because of an error of the map is a finding only if it happens often: a run learns it.
    """
    space = steps.space
    done = steps.completed()
    predicted = run.needed(run.nominal).evaluate(done.state, done.requested).next_state
    states = np.concatenate([steps.state[~steps.follows], done.next_state])
    visited = [
        f"{quantity.name} {low:.3g} to {high:.3g}{unit_suffix(quantity)}"
        for quantity, low, high in zip(space.state, states.min(axis=0), states.max(axis=0), strict=True)
    ]
    counts = _outside(space, states).sum(axis=0)
    trial = _outside(space, run.steps.completed().next_state)
    often = trial.sum(axis=0) > max(_FEW_OUTSIDE, _OFTEN_OUTSIDE * len(trial))
    expected = (_outside(space, done.next_state) & _outside(space, predicted)).sum(axis=0)
    often |= expected > max(_FEW_OUTSIDE, _OUTSIDE * len(done))
    outside = [
        f"{counts[row]} of {len(states)} states are outside the range of use of {visited[row]}"
        for row in np.flatnonzero(counts)
    ]
    if not outside:
        return PartResult("ranges", "ok", f"The robot visited {', '.join(visited)}.")
    if not often.any():
        return PartResult("ranges", "ok", f"{capitalised('; '.join(outside))}.")
    far = np.abs(np.median(space.scaled_state(states), axis=0)) > _FAR
    advice = "Choose the ranges about the states that the robot visits, or targets farther from their ends."
    if far.any():
        names = listed([quantity.name for quantity, is_far in zip(space.state, far, strict=True) if is_far])
        advice = f"Check unit and zero of {names}."
    return PartResult("ranges", "wrong", f"{'; '.join(outside)}. {cause or advice}")


def _outside(space: StepSpace, states: Array) -> NDArray[np.bool_]:
    """Which coordinates of states (N, n) are outside their ranges of use; shape (N, n)."""
    return (states < space.state_lower) | (states > space.state_upper)


_FAR: Final = 5.0  # Median distance from the middle of the range that is hardly one of the robot [half ranges]


def _gap(steps: Steps, nominal: StepMap, cause: str) -> PartResult:
    """How far the map is from the steps."""
    space = steps.space
    error = (steps.next_state - nominal.evaluate(steps.state, steps.requested).next_state) / space.state_scale
    error = error[np.isfinite(error).all(axis=1)]
    if not len(error):
        return PartResult("gap", "left out", f"The map predicts none of the steps. {cause}".strip())
    size = np.sqrt(np.mean(error**2, axis=0))
    text = f"The map misses the next state by {half_ranges(space, size)} half ranges"
    if (size <= _LARGE_GAP).all():
        return PartResult("gap", "ok", f"{text}; a run learns this.")
    offset = np.mean(error, axis=0)
    constant = np.abs(offset) > _CONSTANT * size
    parts = [
        f"{quantity.name} ends {shift:+.2g} half ranges from where the map says: correct the zero of its sensor, or a "
        "constant of the map."
        for quantity, shift, large in zip(space.state, offset, constant & (size > _LARGE_GAP), strict=True)
        if large
    ]
    advice = " ".join(parts) or "Compare the parameters of the map with those of the robot."
    return PartResult("gap", "wrong", f"{text}, which is more than one. {cause or advice}")


_CONSTANT: Final = 0.8  # Part of an error that is the same in all steps from which on it is called an offset


def _response(steps: Steps, nominal: StepMap, noise: Array) -> Iterator[PartResult]:
    """Whether the robot responds to state and command as the map says, without jumps, and to nothing else."""
    derivatives = measured_derivatives(steps, nominal)
    sentences = frozen_states(steps)
    if derivatives and not sentences:
        sentences = [sentence for sentence in (break_of(derivatives),) if sentence]
    differs = derivatives is None or derivatives.contradicting.any() or derivatives.unexplained > REMEMBERED
    if differs and not sentences:
        sentences = causes(steps, nominal, derivatives)
    evidence = contradictions(derivatives) if derivatives else []
    least = LEAST_REMEMBERED if derivatives and (evidence or derivatives.doubtful) else REMEMBERED
    remembered = list(unmeasured_state(derivatives, noise, least)) if derivatives and not sentences else []
    if evidence and not sentences and not remembered:
        advice = "No single mistake explains this: compare these effects in the map with those in the robot's program."
        sentences = [*evidence, advice]
    elif sentences:
        sentences += evidence
    if sentences:
        yield PartResult("response", "wrong", " ".join(sentences))
        return
    if derivatives is None:
        text = "There are too few steps that the map predicts to compare the effects of state and command with it."
        yield PartResult("response", "left out", text)
        return
    if evidence:
        yield PartResult("response", "left out", "The effects cannot be told from what is wrong under `memory`.")
    else:
        text = f"In {len(derivatives.steps)} steps, state and command have the effects that the map expects."
        yield PartResult("response", "ok", text)
    nothing = "The error of a step does not depend on the steps before."
    yield PartResult("memory", "wrong" if remembered else "ok", " ".join(remembered) or nothing)


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


def _noise(run: Run, cause: str) -> PartResult:
    """Whether a repeated step ends alike."""
    noise = run.noise_floor / run.space.state_scale
    if not (np.isfinite(noise).any() and run.summary.noise_floor_measured):
        return PartResult("noise", "left out", "The plant cannot repeat a step, or each repeated step failed.")
    text = f"A repeated step varies by {half_ranges(run.space, noise)} half ranges"
    if not np.nanmax(noise) > _NOISY:
        return PartResult("noise", "ok", f"{text}.")
    advice = "Find what varies and make it a state, or choose another section."
    return PartResult("noise", "wrong", f"{text}, so the state hardly says how the next step ends. {cause or advice}")

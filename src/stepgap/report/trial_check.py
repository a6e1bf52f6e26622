"""What some simulated steps of a robot show before its first run: failures, sections, ranges, the gap, noise."""

from collections.abc import Iterator
from typing import Final

import numpy as np

from stepgap.experiment.inputs import TRIAL_STEPS
from stepgap.experiment.run import Run
from stepgap.learning.steps import Steps
from stepgap.plants.ticks.tick_table import TickTable
from stepgap.records.text import unit_suffix
from stepgap.report.diagnosis_sentences import response_sentences
from stepgap.report.part_results import PartResult, half_ranges
from stepgap.step import StepStatus

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

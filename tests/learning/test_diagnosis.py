"""The diagnosis of robots whose state, noise and commands are known."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from stepgap.control.step_controller import StepController
from stepgap.learning.diagnosis import Diagnosis, diagnose, part_at_bounds
from stepgap.learning.observations import observe
from stepgap.learning.steps import LoggedStep, Steps
from stepgap.step import Array, StepRecord, StepStatus
from tests.control.maps import LossyHopper

Error = Callable[[Array, Array, np.random.Generator], Array]

NOMINAL = LossyHopper()
SPACE = NOMINAL.space
NOISE = np.array([0.01, 0.002])


MIDDLE = np.array([0.2, 0.58])
HOLDING = StepController(NOMINAL)(MIDDLE, MIDDLE).command
"""The command that keeps the state in the middle."""


def steps_of(count: int, seed: int, error: Error) -> Steps:
    """Steps with random commands of a robot whose error is a function of its state and of the error before."""
    rng, steps = np.random.default_rng(seed), []
    state, before = MIDDLE, np.zeros(2)
    for number in range(1, count + 1):
        command = HOLDING + rng.uniform([-6, -3], [6, 3])
        before = error(state, before, rng)
        record = StepRecord(state, command, command, NOMINAL(state, command) + before, StepStatus.OK)
        steps.append(LoggedStep(0, number, state, record.next_state, NOISE, record))
        state = record.next_state
    return Steps(SPACE, steps)


def diagnosis(count: int, seed: int, error: Error) -> Diagnosis:
    return diagnose(observe(steps_of(count, seed, error), NOMINAL))


def plain(state: Array, before: Array, rng: np.random.Generator) -> Array:
    """An error that the state explains, and noise."""
    return np.array([0.02, 0.002]) + np.array([0.1, 0.2]) * (state - MIDDLE) + NOISE * rng.normal(size=2)


def with_memory(state: Array, before: Array, rng: np.random.Generator) -> Array:
    """Half of the error of speed remains in the next step, as of something that is not in the state."""
    return np.array([0.6 * before[0], 0.0]) + NOISE * rng.normal(size=2)


def varying(state: Array, before: Array, rng: np.random.Generator) -> Array:
    """A robot whose speed varies the more the faster it is."""
    return NOISE * rng.normal(size=2) * [0.3 + 4 * np.clip(state[0], 0, 0.5), 1.0]


def test_without_memory_there_is_rarely_a_finding() -> None:
    found = [diagnosis(200, seed, plain) for seed in range(60)]
    assert np.mean([np.any(list(one.gains.values())) for one in found]) <= 0.05
    assert np.mean([one.lagged for one in found]) <= 0.02
    assert np.mean([(one.heteroscedasticity > 1).any() for one in found]) <= 0.05


@pytest.mark.parametrize("seed", range(3))
def test_memory_is_found_in_the_coordinate_that_has_it_with_its_gain(seed: int) -> None:
    found = diagnosis(200, seed, with_memory)
    # Of the variance σ² / (1 − 0.6²), the part 0.6² is predictable, so the error falls to 0.8 of itself.
    assert found.gains["previous_error"] == pytest.approx([0.2, 0.0], abs=0.08)
    assert found.gains["previous_step"][1] == 0


@pytest.mark.parametrize("seed", range(3))
def test_noise_that_depends_on_the_state_is_found(seed: int) -> None:
    ratio = diagnosis(227, seed, varying).heteroscedasticity
    assert ratio[0] > 1.5
    assert ratio[1] == 1


def test_commands_at_bounds() -> None:
    log = steps_of(200, 0, plain)
    bounded = [replace(one, record=replace(one.record, requested=np.array([15.0, 0.0]))) for one in log]
    observed = observe(Steps(SPACE, bounded[:50] + list(log)[50:]), NOMINAL)
    np.testing.assert_allclose(part_at_bounds(observed), [0.25, 0.0])


@pytest.mark.parametrize("count", [0, 1, 5, 30])
def test_too_few_steps_give_no_finding(count: int) -> None:
    found = diagnosis(count, 0, plain)
    assert not found.known
    assert found.steps == count

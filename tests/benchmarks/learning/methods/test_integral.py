"""The integral correction: its recursion, and its equality with the residual that stands for it."""

from dataclasses import replace

import numpy as np

from benchmarks.learning.methods.integral import IntegralCorrection
from benchmarks.learning.methods.physical_parameters import AdjustedMap
from stepgap.experiment.methods import INTEGRAL_GAIN, METHODS
from stepgap.learning.learner import Learner
from stepgap.learning.steps import Steps
from tests.benchmarks.learning.methods.known_robots import NOMINAL, steps_of

GAIN = 0.3
STATE, COMMAND = np.array([0.2, 0.58]), np.array([2.0, -5.0])


def test_the_integral_follows_a_constant_error() -> None:
    shift = np.array([0.05, -0.02])
    log = steps_of(AdjustedMap(NOMINAL, shift), 3)
    correction = IntegralCorrection.start(NOMINAL, Steps(NOMINAL.space), GAIN)
    for count, logged in enumerate(log, start=1):
        correction = correction.after(logged)
        added = correction.step_map()(STATE, COMMAND) - NOMINAL(STATE, COMMAND)
        np.testing.assert_allclose(added, (1 - (1 - GAIN) ** count) * shift)
    known_before = IntegralCorrection.start(NOMINAL, log, GAIN)
    np.testing.assert_allclose(known_before.step_map()(STATE, COMMAND), correction.step_map()(STATE, COMMAND))


def test_the_method_of_a_run_is_the_integral() -> None:
    truth = AdjustedMap(NOMINAL, np.array([0.05, -0.02]), command_scale=0.9)
    before, now = steps_of(truth, 40), steps_of(truth, 10, iteration=1)
    alone = IntegralCorrection.start(NOMINAL, before, INTEGRAL_GAIN)
    learner = Learner.start(NOMINAL, before, replace(METHODS["integral"].learning, drift=False), 1)
    for logged in now:
        alone, learner = alone.after(logged), learner.after(logged)
        np.testing.assert_allclose(learner.residual.mean([*STATE, *COMMAND]), alone.shift, rtol=2e-3)

"""The targets of a trial: those of a reference in random order, so that every part of the response is seen."""

import numpy as np

from stepgap.base.random_streams import random_stream
from stepgap.control.reference import Reference
from stepgap.experiment.settings import Experiment
from stepgap.learning.diagnosis import FEWEST_STEPS_PER_WEIGHT

TRIAL_STEPS = 20
"""Number of steps of a trial that are drawn."""

LONGEST_HELD = 3
"""Largest number of steps for which a trial holds a target."""


def trial_reference(settings: Experiment, held: Reference) -> Reference:
    """The targets of a reference in random order, each for one to `LONGEST_HELD` steps.

    There are at least `TRIAL_STEPS` of them, and as many as `command_response` needs.
    """
    targets, rng = held.targets[held.distinct[0]], random_stream(settings.seed, 0, 3)
    weights = 1 + len(settings.robot.space.state) + 2 * len(settings.robot.space.command)
    steps = max(TRIAL_STEPS, 1 + FEWEST_STEPS_PER_WEIGHT * weights)
    numbers = np.repeat(rng.integers(len(targets), size=steps), rng.integers(1, LONGEST_HELD + 1, size=steps))
    return Reference(held.names, targets[numbers[:steps]])

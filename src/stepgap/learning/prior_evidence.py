"""Which prior over robots is right for a robot, if any: the one that makes its steps most probable."""

import math
from collections.abc import Sequence
from typing import Final, cast

from stepgap.learning.observations import Observations
from stepgap.learning.polynomial import NOISE_SCALE, PRIOR_COUNT, Polynomial, fit_polynomial
from stepgap.learning.prior import DEGREE, PRIOR, Prior
from stepgap.learning.residual import HistoryInputs, Residual

PRIOR_ODDS: Final = 20.0
"""Odds that a robot is of the kind of its prior before it has made a step."""


def residual_with(prior: Prior | None, observations: Observations) -> Residual:
    """The residual with a prior over robots, or with the weak one."""
    inputs = HistoryInputs(context_inputs=observations.context_inputs)
    data = [observations.training_data(inputs, number) for number in range(len(observations.space.state))]
    found = [
        fit_polynomial(each, DEGREE, prior.moments(number, each) if prior else None) for number, each in enumerate(data)
    ]
    return Residual(PRIOR, tuple(found), len(observations.space.command), inputs)


def most_probable(priors: Sequence[Prior], observations: Observations) -> Residual:
    """The residual with the prior that makes the observations most probable; the first of equally probable ones."""
    return max((residual_with(each, observations) for each in priors), key=_log_evidence)


def _log_evidence(residual: Residual) -> float:
    return sum(cast("Polynomial", each).log_evidence for each in residual.regressions)


def applies(expected: Residual, observations: Observations) -> bool:
    """Whether the robot is probably of the kind of a prior, by the observations and those odds beforehand.

    The others are a robot of which nothing is known, and one on which the nominal map is right but for noise.

    Args:
        expected: The residual with that prior.
        observations: What it was fitted to.
    """
    if not len(observations):
        return True
    others = max(_log_evidence(residual_with(None, observations)), log_evidence_of_none(observations))
    return _log_evidence(expected) + math.log(PRIOR_ODDS) > others


def log_evidence_of_none(observations: Observations) -> float:
    """Logarithm of the density of errors that are noise of unknown size, without its factor (2π)^(−N/2).

    That of each coordinate is Student's t distribution in N dimensions.
    """
    errors, scale, total = observations.error.T, math.sqrt(PRIOR_COUNT) * NOISE_SCALE, 0.0
    for each, unit in zip(errors, observations.space.state_scale, strict=True):
        before, after = PRIOR_COUNT / 2, (PRIOR_COUNT + len(each)) / 2
        rates = (scale * unit) ** 2 / 2, ((scale * unit) ** 2 + float(each @ each)) / 2
        total += before * math.log(rates[0]) - after * math.log(rates[1]) + math.lgamma(after) - math.lgamma(before)
    return total

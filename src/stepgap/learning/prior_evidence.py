"""What the steps of a robot say about which robots it is like: those of a prior, that of an earlier run, or none known.

Each possibility is a quadratic polynomial of the error with its own prior: a prior over robots, the steps of earlier
runs beside it, or a weak one that knows nothing. They are compared by how probable they make the steps of this robot.
"""

import math
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Final, cast

import numpy as np
from numpy.typing import NDArray

from stepgap.learning.observations import Observations
from stepgap.learning.polynomial import NOISE_SCALE, PRIOR_COUNT, Polynomial, fit_polynomial
from stepgap.learning.prior import DEGREE, PRIOR, Prior
from stepgap.learning.residual import HistoryInputs, Residual

PRIOR_ODDS: Final = 20.0
"""Odds that a robot is of the kind of its prior, or that of an earlier run, before it has made a step."""


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


def other_robots(observations: Observations, priors: Sequence[Prior]) -> list[int]:
    """Numbers of the deployments of earlier runs that are probably of another robot.

    Compared are all earlier runs as one robot, each of them alone, and none; all are kept before the first step.

    Args:
        observations: Of this run, and of earlier ones, which have negative numbers of deployments.
        priors: Priors over robots, of which one applies in each case; none for the weak one.
    """
    deployment = observations.labels[:, 0]
    runs = [np.isin(deployment, run) for run in _runs(np.unique(deployment[deployment < 0]).tolist())]
    own = deployment >= 0
    if not runs or not own.any():
        return []

    def evidence(rows: NDArray[np.bool_]) -> float:
        chosen = observations.selected(rows)
        return float(np.logaddexp.reduce([_log_evidence(residual_with(each, chosen)) for each in priors or [None]]))

    possible = [np.zeros(len(own), bool), np.any(runs, axis=0), *(runs if len(runs) > 1 else ())]
    odds = [0.0] + [math.log(PRIOR_ODDS)] * (len(possible) - 1)
    scores = [one + evidence(rows | own) - evidence(rows) for one, rows in zip(odds, possible, strict=True)]
    return np.unique(deployment[~own & ~possible[int(np.argmax(scores))]]).tolist()


def _runs(deployments: Sequence[int]) -> Iterator[Sequence[int]]:
    """Splits ascending numbers of deployments into runs, between which a number is missing."""
    cuts = [place for place, (one, other) in enumerate(pairwise(deployments), 1) if other > one + 1]
    return (deployments[begin:end] for begin, end in pairwise([0, *cuts, len(deployments)]) if end > begin)

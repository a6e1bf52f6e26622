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
from stepgap.learning.polynomial import Polynomial, fit_polynomial
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


def _log_evidence(residual: Residual) -> float:
    return sum(cast("Polynomial", each).log_evidence for each in residual.regressions)


def applies(expected: Residual, observations: Observations) -> bool:
    """Whether the robot is probably of the kind of a prior, by the observations and those odds beforehand.

    Args:
        expected: The residual with that prior.
        observations: What it was fitted to.
    """
    if not len(observations):
        return True
    return _log_evidence(expected) + math.log(PRIOR_ODDS) > _log_evidence(residual_with(None, observations))


def other_robots(observations: Observations, prior: Prior | None) -> list[int]:
    """Numbers of the deployments of earlier runs that are probably of another robot.

    Compared are all earlier runs as one robot, each of them alone, and none; all are kept before the first step.

    Args:
        observations: Of this run, and of earlier ones, which have negative numbers of deployments.
        prior: Prior over robots, which this robot is of in each case.
    """
    deployment = observations.labels[:, 0]
    runs = [np.isin(deployment, run) for run in _runs(np.unique(deployment[deployment < 0]).tolist())]
    own = deployment >= 0
    if not runs or not own.any():
        return []

    def evidence(rows: NDArray[np.bool_]) -> float:
        return _log_evidence(residual_with(prior, observations.selected(rows)))

    possible = [np.zeros(len(own), bool), np.any(runs, axis=0), *(runs if len(runs) > 1 else ())]
    odds = [0.0] + [math.log(PRIOR_ODDS)] * (len(possible) - 1)
    scores = [one + evidence(rows | own) - evidence(rows) for one, rows in zip(odds, possible, strict=True)]
    return np.unique(deployment[~own & ~possible[int(np.argmax(scores))]]).tolist()


def _runs(deployments: Sequence[int]) -> Iterator[Sequence[int]]:
    """Splits ascending numbers of deployments into runs, between which a number is missing."""
    cuts = [place for place, (one, other) in enumerate(pairwise(deployments), 1) if other > one + 1]
    return (deployments[begin:end] for begin, end in pairwise([0, *cuts, len(deployments)]) if end > begin)

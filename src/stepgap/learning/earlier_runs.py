"""Which earlier runs are of the robot that steps now, by how probable they make its steps.

The error of a robot is a quadratic polynomial of state and command. If an earlier run is of this robot, its steps say
what the polynomial is; if not, only a prior over robots does, or the weak one. The odds between the two are those of
the steps of this robot (marginal likelihood; MacKay, Information Theory, Inference, and Learning Algorithms, Ch. 28).
Each run is judged alone, and is left out from clear odds on, so that runs of one robot are not told apart by chance.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final, Self, final

import numpy as np

from stepgap.learning.observations import Observations, observe
from stepgap.learning.polynomial import Moments, monomials, weak_prior
from stepgap.learning.prior import DEGREE, Prior
from stepgap.learning.regression import TrainingData
from stepgap.learning.residual import HistoryInputs
from stepgap.learning.steps import Steps
from stepgap.step import StepMap

SAME_ROBOT_ODDS: Final = 20.0
"""Odds that an earlier run is of this robot, before it has made a step."""


@final
@dataclass(frozen=True, eq=False)
class EarlierRuns:
    """Earlier runs, reduced to the sums that are needed to compare them with the steps of a robot.

    Attributes:
        steps: Number of their steps.
        deployments: Numbers of the deployments of each run.
        sums: Of each run and state coordinate.
        priors: Moments without data, of each prior over robots and state coordinate; those of the weak one without any.
    """

    steps: int
    deployments: tuple[frozenset[int], ...]
    sums: tuple[tuple[Moments, ...], ...]
    priors: tuple[tuple[Moments, ...], ...]

    @classmethod
    def of(cls, known: Steps, nominal: StepMap, priors: Sequence[Prior]) -> Self:
        """The earlier runs among some steps, which have negative numbers of deployments; one is missing between two."""
        runs = tuple(map(frozenset, _runs(sorted(number for number in known.iterations if number < 0))))
        steps = [observe(known.selected(np.isin(known.iteration, [*run])).planned(), nominal) for run in runs]
        data = _training_data(observe(known.selected(slice(0)), nominal))
        weak = tuple(weak_prior(each, DEGREE) for each in data)
        found = tuple(tuple(prior.moments(number, each) for number, each in enumerate(data)) for prior in priors)
        return cls(int(np.sum(known.iteration < 0)), runs, tuple(_sums(each) for each in steps), found or (weak,))

    def of_others(self, own: Observations, left_out: frozenset[int] = frozenset()) -> frozenset[int]:
        """Numbers of the deployments that are not of the robot whose steps are `own`.

        Args:
            own: Steps of the robot.
            left_out: What this was before. A run that was left out is used again only if it is more probable than not.
        """
        if not len(own):
            return left_out
        mine, found = _sums(own), set[int]()
        alone = self._log_evidence(mine)
        for run, sums in zip(self.deployments, self.sums, strict=True):
            together = tuple(one.joined(other) for one, other in zip(sums, mine, strict=True))
            log_odds = self._log_evidence(together) - self._log_evidence(sums) - alone
            if log_odds < (0.0 if run <= left_out else -math.log(SAME_ROBOT_ODDS)):
                found |= run
        return frozenset(found)

    def _log_evidence(self, sums: tuple[Moments, ...]) -> float:
        """Logarithm of the probability density of steps, if their robot is one of the priors, equally probable ones."""
        found = [
            sum(prior.joined(each).log_evidence(prior) for prior, each in zip(priors, sums, strict=True))
            for priors in self.priors
        ]
        return float(np.logaddexp.reduce(found)) - math.log(len(found))


def _training_data(steps: Observations) -> list[TrainingData]:
    inputs = HistoryInputs(context_inputs=steps.context_inputs)
    return [steps.training_data(inputs, number) for number in range(len(steps.space.state))]


def _sums(steps: Observations) -> tuple[Moments, ...]:
    """Sums over steps, without a prior."""
    found = list[Moments]()
    for data in _training_data(steps):
        basis = monomials(data.scaled(data.points), DEGREE)
        size = basis.shape[1]
        empty = Moments(np.zeros((size, size)), np.zeros(size), 0.0, 0.0)
        found.append(empty.plus(basis, data.values, np.ones(len(basis))))
    return tuple(found)


def _runs(deployments: Sequence[int]) -> Iterator[Sequence[int]]:
    """Splits ascending numbers of deployments into runs, between which a number is missing."""
    cuts = [place for place, (one, other) in enumerate(pairwise(deployments), 1) if other > one + 1]
    return (deployments[begin:end] for begin, end in pairwise([0, *cuts, len(deployments)]) if end > begin)

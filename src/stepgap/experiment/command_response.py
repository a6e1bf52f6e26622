"""Whether recorded steps respond to their commands, and with which delay, whatever a map says.

The next state is regressed on state, command and the command of the step before. A command acts if it explains more
than chance beyond the two others, by an F test. Where commands hardly vary for equal states, the steps show nothing. So
the effect that a map expects is compared with the scatter; that a small one is not seen is no finding.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import fdtrc

from stepgap.gauss.linear_regression import fit_linear
from stepgap.learning.steps import Steps
from stepgap.step import Array, StepMap

CONFIDENT: Final = 0.001  # Largest p-value of a finding: several hypotheses are tested in every deployment
FEWEST_STEPS_PER_WEIGHT: Final = 4  # Fewest steps for each weight of a regression
CLEARLY_SEEN: Final = 8.0  # Smallest expected effect, in standard errors, whose absence is a finding


@dataclass(frozen=True, eq=False)
class CommandResponse:
    """What some steps show of the effect of their commands on each state coordinate; shapes (n,).

    Attributes:
        steps: Number of steps.
        acts: Whether the command of the same step has an effect.
        acts_later: Whether the command of the step before has one.
        expected: Whether the map expects an effect of the same step that these steps would clearly show.
    """

    steps: int
    acts: NDArray[np.bool_]
    acts_later: NDArray[np.bool_]
    expected: NDArray[np.bool_]


def command_response(log: Steps, nominal: StepMap) -> CommandResponse | None:
    """Judges the steps of one deployment that directly follow another one; None if they are too few.

    Args:
        nominal: Map that says which effect is expected.
    """
    rows = np.flatnonzero(log.follows & np.isfinite(log.next_state).all(axis=1) & ~log.doubtful)
    here = log.selected(rows)
    before = log.selected(rows - 1)
    plain = np.hstack([np.ones((len(rows), 1)), here.state])
    n = len(log.space.state)
    m = len(log.space.command)
    if len(rows) < FEWEST_STEPS_PER_WEIGHT * (1 + n + 2 * m):
        return None
    now = here.requested
    later = before.requested
    both = fit_linear(np.hstack([plain, now, later]), here.next_state)
    acts, acts_later = (
        _explains(fit_linear(np.hstack([plain, other]), here.next_state).residual, both.residual, m, len(rows))
        for other in (later, now)
    )
    by_command = nominal.jacobian(here.state, now)[..., n:]
    usable = np.isfinite(by_command).all(axis=(1, 2))
    if not usable.any():
        return CommandResponse(len(rows), acts, acts_later, np.zeros(n, bool))
    varied = fit_linear(np.hstack([plain, later]), now).residual @ np.median(by_command[usable], axis=0).T
    scatter = np.sqrt(np.mean(both.residual**2, axis=0))
    return CommandResponse(len(rows), acts, acts_later, np.linalg.norm(varied, axis=0) > CLEARLY_SEEN * scatter)


def _explains(without: Array, both: Array, added: int, count: int) -> NDArray[np.bool_]:
    """Whether some columns reduce the residual (N, n) by more than chance does; shape (n,)."""
    before = np.sum(without**2, axis=0)
    after = np.sum(both**2, axis=0)
    free = count - 1 - both.shape[1] - 2 * added
    statistic = np.maximum(before - after, 0) / added / np.maximum(after / free, 1e-300)
    return np.asarray(fdtrc(added, free, statistic) < CONFIDENT)

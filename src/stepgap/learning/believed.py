"""How beliefs meet a step map: a step as they see it, and the map that they plan with.

A run and every exported controller do both by the functions here.
"""

from typing import Final

import numpy as np

from stepgap.gauss.features import Features
from stepgap.learning.beliefs import Beliefs, Mixture, Observed
from stepgap.learning.corrected_map import CorrectedMap
from stepgap.learning.observations import Observations, context_inputs_of, no_observations
from stepgap.learning.posterior import POSTERIOR, Posterior
from stepgap.learning.residual import HistoryInputs, Residual, join_points
from stepgap.step import Array, CommandBefore, StepMap, StepRecord

LARGEST: Final = 1e6
"""Largest number of a step that is learned from [half ranges]: the square of a larger one could be no number."""


def observed(record: StepRecord, nominal: StepMap, error: Array, phase: float) -> Observed | None:
    """A step as beliefs see it; None if a number of it is missing, or far from every range.

    Args:
        error: What is believed about: its error, less that of a fitted residual; shape (n,) [units of the state].
        phase: Phase at which it started [rad], NaN if it is unknown.
    """
    space = nominal.space
    context = context_inputs_of(record.context, nominal.space)

    def point(state: Array) -> Array:
        return np.concatenate([space.scaled_inputs(space.onward(state), record.requested), context])

    def from_elsewhere(offset: Array) -> tuple[Array, Array, Array] | None:
        start = record.state - offset * space.state_scale
        slope = nominal.jacobian(start, record.requested)[:, : len(offset)]
        moved = (
            nominal.evaluate(record.state, record.requested).next_state
            - nominal.evaluate(start, record.requested).next_state
        )
        moved_error = (error + moved) / space.state_scale
        slope = slope * space.state_scale / space.state_scale[:, None]
        return (
            (point(start), moved_error, slope) if np.isfinite(moved_error).all() and np.isfinite(slope).all() else None
        )

    inputs = point(record.state)
    scaled = error / space.state_scale
    if not (np.abs(np.concatenate([inputs, scaled])) <= LARGEST).all():
        return None
    return Observed(inputs, scaled, phase, command=space.point_of(record.requested), from_elsewhere=from_elsewhere)


def believed_after(
    beliefs: Beliefs,
    nominal: StepMap,
    residual: Residual,
    record: StepRecord,
    error: Array,
    phase: float,
    *,
    planned: bool = True,
) -> tuple[Beliefs, bool]:
    """What is believed after a step, and whether the step was learned.

    Args:
        beliefs: What was believed before.
        residual: The fitted residual, a function of state and command.
        error: Error of the nominal map at it, NaN where it is unknown; shape (n,) [units of the state].
        phase: Phase at which it started [rad], NaN if it is unknown.
        planned: Whether its command was planned: the first step of a plant is learned without a judgement.
    """
    if not np.isfinite(error).all():
        return beliefs.unlinked(), False
    if residual.kind != "none":
        error = error - residual.mean(join_points(record.state, record.requested))
    step = observed(record, nominal, error, phase)
    if step is None:
        return beliefs.unlinked(), False
    return (beliefs.after(step) if planned else beliefs.taught(step)), True


def believed(residual: Residual, features: Features, mixture: Mixture, seen: Observations) -> Residual:
    """The mixture of the beliefs about a step, added to a fitted residual.

    Args:
        features: Those of the beliefs about its remaining error.
        mixture: Their mixture.
        seen: Steps that become the data of the result, for reports.
    """
    space = seen.space
    base = residual if residual.kind != "none" else None
    context = len(space.context_inputs)
    inputs = base.history_inputs if base else HistoryInputs(context_inputs=context)
    n = len(space.state)
    m = len(space.command)
    data = [seen.training_data(inputs, coordinate) for coordinate in range(n)]
    first = len(data[0].scale) - context - inputs.timed
    used = (*range(n + m), *range(first, first + context))
    regressions = tuple(
        Posterior(
            data=data[coordinate],
            features=features,
            mean_weights=mixture.mean[coordinate],
            covariance=mixture.covariance[coordinate],
            side=mixture.side,
            noise=float(np.sqrt(mixture.noise[coordinate])),
            used=used,
            base=base.regressions[coordinate] if base else None,
        )
        for coordinate in range(n)
    )
    return Residual(POSTERIOR, regressions, m, inputs)


def planning_map(
    nominal: StepMap, residual: Residual, beliefs: Beliefs | None, phase: float, history: Array
) -> CorrectedMap:
    """The map that plans a step.

    Args:
        beliefs: What is believed of its remaining error; None for nothing.
        phase: Phase at which the step starts [rad], NaN if it is unknown.
        history: History of the step, as `observations` defines it.
    """
    if beliefs is None:
        return CorrectedMap(nominal, residual.conditioned_on(history))
    mixture = beliefs.mixture(phase)
    mixed = believed(residual, beliefs.features, mixture, no_observations(nominal.space))
    space = nominal.space
    offset = mixture.offset * space.state_scale
    return CorrectedMap(
        nominal,
        mixed.conditioned_on(history),
        offset=offset if offset.any() else None,
        before=command_before_of(nominal, mixture) if space.is_lagged else None,
    )


def command_before_of(nominal: StepMap, mixture: Mixture) -> CommandBefore:
    """The expected effect of the command of the step before; the last features are the error before and this command.

    The error of the step before is its end less what the nominal map expects. So it would have been another one with
    another command, too.
    """
    space = nominal.space
    n = len(space.state)
    m = len(space.command)
    memory = mixture.mean[:, -m - n : -m] * space.state_scale[:, None] / space.state_scale
    of_command = mixture.mean[:, -m:] * space.state_scale[:, None] / space.command_scale
    expected = nominal.jacobian(space.state_centre, space.command_centre)[:, n:]
    effect = of_command - memory @ expected if np.isfinite(expected).all() else of_command
    return CommandBefore(effect, space.command_at(mixture.side[-m:]), memory)

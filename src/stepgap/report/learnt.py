"""What a run learnt: the last residual of its folder, and what it says of the steps it was fitted to."""

import json
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Final

import numpy as np

from stepgap.learning.regression import Prediction
from stepgap.learning.residual import HistoryInputs, Residual
from stepgap.learning.residual_fit import residual_from_dict
from stepgap.records.summary import read_text
from stepgap.step import Array, Quantity, StepSpace

LARGEST_MODEL: Final = 2**28
"""Largest `models/iteration_K.json` that is read [bytes]."""


@dataclass(frozen=True, eq=False)
class Learnt:
    """A residual and the deployment that used it; it was fitted to the steps of those before.

    Attributes:
        iteration: Number of that deployment.
        residual: What it was corrected by when it began.
    """

    iteration: int
    residual: Residual

    @property
    def steps(self) -> int:
        """Number of steps that the residual was fitted to; 0 of one that keeps none."""
        return len(self.residual.regressions[0].values)

    @cached_property
    def leave_one_out(self) -> list[Prediction]:
        """What each regression predicts of each of its N values from all others."""
        singles = [slice(row, row + 1) for row in range(self.steps)]
        return [regression.left_out(singles) for regression in self.residual.regressions]

    @property
    def standardised_errors(self) -> list[Array]:
        """Distance of each value from its leave-one-out prediction, in standard deviations; shapes (N,)."""
        pairs = zip(self.residual.regressions, self.leave_one_out, strict=True)
        return [(regression.values - predicted.mean) / predicted.std for regression, predicted in pairs]


def read_learnt(folder: Path, last: int, space: StepSpace) -> Learnt | None:
    """The residual with which a deployment began; None if no model was saved, as before one with the nominal map.

    Args:
        folder: The run folder.
        last: Number of the deployment.
        space: State and command of the run.

    Raises:
        ValueError: The file is not a model of this run.
        OSError: It cannot be read.
    """
    path = folder / "models" / f"iteration_{last}.json"
    text = read_text(path, LARGEST_MODEL)
    if text is None:
        return None
    try:
        residual = residual_from_dict(json.loads(text))
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError, np.linalg.LinAlgError) as error:
        short = " ".join(str(error).split())[:120]
        raise ValueError(f"{path}: not a residual ({short}); it must be the file that the run wrote") from None
    wanted = (len(space.state), len(space.command))
    if residual.sizes != wanted:
        raise ValueError(f"{path}: of (state, command) sizes {residual.sizes}, in steps.csv {wanted}; not of one run")
    return Learnt(last, residual)


def input_quantities(space: StepSpace, history_inputs: HistoryInputs) -> list[Quantity]:
    """Names and units of a residual's inputs; those of the step before are normalised by half their range."""
    before = [Quantity(f"error of {each.name} before", "half ranges", -1, 1) for each in space.state]
    if history_inputs.features == "previous_step":
        before += [Quantity(f"{each.name} before", "half ranges", -1, 1) for each in (*space.command, *space.state)]
    elif history_inputs.features == "none":
        before = []
    time = [Quantity("time", "memories", -1, 1)] if history_inputs.timed else []
    return [*space.state, *space.command, *before, *time]

"""Model files `models/iteration_K.json`: the residual with which a deployment of a run began."""

import json
from pathlib import Path
from typing import Final

import numpy as np

from stepgap.base.files import write_whole
from stepgap.learning.residual import Residual
from stepgap.learning.residual_fit import residual_from_dict
from stepgap.records.summary import read_text
from stepgap.step import StepSpace

LARGEST_MODEL: Final = 2**28
"""Largest model file that is read [bytes]."""


def model_path(folder: Path, iteration: int) -> Path:
    """Path of the model with which a deployment of a run began."""
    return folder / "models" / f"iteration_{iteration}.json"


def write_model(folder: Path, iteration: int, residual: Residual) -> None:
    """Writes the residual with which a deployment begins into the run folder."""
    write_whole(model_path(folder, iteration), json.dumps(residual.to_dict()))


def read_model(folder: Path, iteration: int, space: StepSpace) -> Residual | None:
    """Reads the residual with which a deployment began; None if no model was saved, as for the nominal map.

    Args:
        folder: The run folder.
        iteration: Number of the deployment.
        space: State and command of the run.

    Raises:
        ValueError: The file is not a model of this run; the message is one line.
        OSError: It cannot be read.
    """
    path = model_path(folder, iteration)
    text = read_text(path, LARGEST_MODEL)
    if text is None:
        return None
    try:
        data = json.loads(text)
        if isinstance(data, dict) and "features" in data:
            raise ValueError("written by a former version; run the experiment again")
        residual = residual_from_dict(data)
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError, np.linalg.LinAlgError) as error:
        short = " ".join(str(error).split())[:120]
        raise ValueError(f"{path}: not a residual ({short}); it must be the file that the run wrote") from None
    wanted = (len(space.state), len(space.command))
    if residual.sizes != wanted:
        raise ValueError(
            f"{path}: (state, command) sizes are {residual.sizes}, in steps.csv {wanted}; both must be of the same run"
        )
    return residual

"""Model files `models/iteration_K.json`: the residual with which a deployment of a run began.

Besides the residual, a file has a schema number, names and units of state and command, and some steps of the nominal
map, by which another nominal map is noticed: its error is not the learned one. docs/model_file.md has all keys.
"""

import json
from collections.abc import Mapping
from math import isfinite
from pathlib import Path
from typing import Any, Final

import numpy as np

from stepgap.base.files import write_whole
from stepgap.learning.residual import Residual
from stepgap.learning.residual_fit import residual_from_dict
from stepgap.records.summary import read_text
from stepgap.step import Array, StepMap, StepSpace

SCHEMA: Final = 1
"""Number of the format."""

SAME_STEP: Final = 1e-6
"""Largest difference of the same step on other machines and versions [half ranges]."""

LARGEST_MODEL: Final = 2**28
"""Largest model file that is read [bytes]."""


def model_path(folder: Path, iteration: int) -> Path:
    """Path of the model with which a deployment of a run began."""
    return folder / "models" / f"iteration_{iteration}.json"


def write_model(folder: Path, iteration: int, residual: Residual, nominal: StepMap) -> None:
    """Writes the residual with which a deployment begins, and what identifies its nominal map, into the run folder."""
    space = nominal.space
    names = {
        key: [[quantity.name, quantity.unit] for quantity in quantities]
        for key, quantities in (("state", space.state), ("command", space.command))
    }
    content = {"schema": SCHEMA, **names, "nominal_steps": _steps_of(nominal), **residual.to_dict()}
    write_whole(model_path(folder, iteration), json.dumps(content))


def read_model(folder: Path, iteration: int, space: StepSpace, nominal: StepMap | None = None) -> Residual | None:
    """Reads the residual with which a deployment began; None if no model was saved, as for the nominal map.

    Args:
        folder: The run folder.
        iteration: Number of the deployment.
        space: State and command of the run.
        nominal: Nominal map with which the residual will be used; None for no check.

    Raises:
        ValueError: The file is not a model of this run or of this nominal map; the message is one line.
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
        if data.get("schema", SCHEMA) != SCHEMA:
            raise ValueError(f"schema must be {SCHEMA}, not {data['schema']!r:.40}")
        residual = residual_from_dict(data)
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError, np.linalg.LinAlgError) as error:
        short = " ".join(str(error).split())[:120]
        raise ValueError(f"{path}: not a residual ({short}); it must be the file that the run wrote") from None
    wanted = (len(space.state), len(space.command))
    if residual.sizes != wanted:
        raise ValueError(
            f"{path}: (state, command) sizes are {residual.sizes}, in steps.csv {wanted}; both must be of the same run"
        )
    _check_names(path, data, space)
    if nominal is not None:
        _check_nominal(path, data, nominal)
    return residual


def _check_names(path: Path, data: Mapping[str, Any], space: StepSpace) -> None:
    """Raises ValueError if the file names other coordinates."""
    for key, names in (("state", space.state_names), ("command", space.command_names)):
        pairs = data.get(key)
        found = [str(pair[0]) for pair in pairs if isinstance(pair, list) and pair] if isinstance(pairs, list) else None
        if pairs is not None and found != list(names):
            raise ValueError(f"{path}: {key} must be {', '.join(names)}, as in steps.csv, not {pairs!r:.80}")


def _steps_of(nominal: StepMap) -> list[list[float | None]]:
    """Next states of the nominal map at the middle of the ranges and half-way to the bounds; None for a failed step."""
    outcome = nominal.evaluate(*_points(nominal.space))
    return [
        [float(f"{value:.9g}") if isfinite(value) else None for value in row] for row in outcome.next_state.tolist()
    ]


def _points(space: StepSpace) -> tuple[Array, Array]:
    """States and commands of the steps that identify a nominal map."""
    n, m = len(space.state), len(space.command)
    offsets = 0.5 * np.vstack([np.zeros(n + m), np.eye(n + m), -np.eye(n + m)])
    return (
        space.state_centre + offsets[:, :n] * space.state_scale,
        space.command_centre + offsets[:, n:] * space.command_scale,
    )


def _check_nominal(path: Path, data: Mapping[str, Any], nominal: StepMap) -> None:
    """Raises ValueError unless the nominal map takes the steps in the file."""
    try:
        recorded = np.array(data["nominal_steps"], float)
    except (KeyError, TypeError, ValueError):
        raise ValueError(f"{path}: has no steps of its nominal map; run the experiment again") from None
    here = nominal.evaluate(*_points(nominal.space)).next_state
    if recorded.shape == here.shape:
        same = np.isclose(recorded, here, rtol=0, atol=SAME_STEP * nominal.space.state_scale, equal_nan=True)
        if same.all():
            return
    raise ValueError(f"{path}: was learned on another nominal map; use the nominal map and the settings of its run")

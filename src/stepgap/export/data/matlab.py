"""A run as a MAT-file (version 5), which MATLAB and Octave load: structs of columns."""

import re
from collections.abc import Mapping, Sequence
from io import BytesIO
from typing import Any

import numpy as np
from scipy.io import savemat

from stepgap.base.errors import InputError
from stepgap.base.ranges import LARGEST_INTEGER
from stepgap.experiment.run import Run
from stepgap.records.missing import Missing
from stepgap.records.step_columns import Column
from stepgap.records.summary import MEASURES, NoiseFloor, Summary

LONGEST_FIELD_NAME = 63  # Largest length of a field's name in MATLAB


def matlab_file(run: Run, columns: Sequence[Column]) -> bytes:
    """Content of the MAT-file, with the variables `steps`, `units`, `meanings`, `settings` and `summary`.

    Raises:
        InputError: A column or setting has a name that is not allowed in MATLAB.
    """
    variables: dict[str, Any] = {
        "steps": {column.name: _column(column.values) for column in columns},
        "units": {column.name: column.unit for column in columns},
        "meanings": {column.name: column.meaning for column in columns},
        "settings": _value({} if isinstance(run.settings_file, Missing) else run.settings_file.table),
        "summary": _summary(run.summary, run.space.state_names),
    }
    _check_names(variables)
    stream = BytesIO()
    savemat(stream, variables, long_field_names=True, oned_as="column")
    return stream.getvalue()


def _column(values: np.ndarray) -> np.ndarray:
    """Converts numbers to doubles, and strings to a cell array."""
    return values.astype(object if values.dtype.kind == "U" else float)


def _value(value: Any) -> Any:
    """Converts TOML tables to structs, and lists (which no experiment has) to cell arrays."""
    if isinstance(value, Mapping):
        return {name: _value(entry) for name, entry in value.items()}
    if isinstance(value, list):
        return np.array([_value(item) for item in value] + [None], dtype=object)[:-1]
    if isinstance(value, bool | float):
        return value
    return float(value) if isinstance(value, int) and abs(value) < LARGEST_INTEGER else str(value)


def _summary(summary: Summary, names: Sequence[str]) -> dict[str, Any]:
    """Errors of the finished deployments as columns, with one number per deployment."""
    done = summary.deployments
    counts = {
        "iteration": [deployment.iteration for deployment in done],
        "steps": [deployment.steps for deployment in done],
        "falls": [deployment.failed_steps for deployment in done],
        "cut": [deployment.cut for deployment in done],
    }
    errors = {
        measure: {
            name: np.array([deployment.errors[measure][i] for deployment in done], float)
            for i, name in enumerate(names)
        }
        for measure in MEASURES
    }
    floor = summary.noise_floor or NoiseFloor.unknown(len(names))
    return {
        **{name: _column(np.array(numbers)) for name, numbers in counts.items()},
        "residual": np.array([deployment.residual for deployment in done], dtype=object),
        **errors,
        "repeatability": dict(zip(names, floor.any_phase.tolist(), strict=True)),
        "repeatability_same_yaw": dict(zip(names, floor.same_phase.tolist(), strict=True)),
        "seed": np.nan if summary.seed is None else float(summary.seed),
        "versions": _value(dict(summary.versions)),
    }


def _check_names(struct: Mapping[str, Any]) -> None:
    for name, value in struct.items():
        if not re.fullmatch(f"[A-Za-z][A-Za-z0-9_]{{0,{LONGEST_FIELD_NAME - 1}}}", name):
            raise InputError(f"{name!r:.80}: not a valid name in MATLAB; export to csv instead")
        if isinstance(value, Mapping):
            _check_names(value)

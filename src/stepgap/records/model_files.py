"""Model files: the residual with which a deployment of a run began, or which `stepgap fit --save` wrote.

Besides the residual, a file has a schema number, names and units of state and command, and the source of the nominal
next states. If that is a map, the file has some of its steps, by which another nominal map is noticed: its error is not
the learned one. docs/model_file.md has all keys.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import Any, Final, NamedTuple, final

import numpy as np

from stepgap.base.files import own_folder, write_whole
from stepgap.base.json_data import as_object
from stepgap.base.ranges import require
from stepgap.learning.beliefs import Beliefs
from stepgap.learning.beliefs_data import beliefs_from_dict, beliefs_to_dict
from stepgap.learning.residual import Residual
from stepgap.learning.residual_check import naming_model
from stepgap.learning.residual_fit import residual_from_dict
from stepgap.records.summary import read_text
from stepgap.step import Array, StepMap, StepSpace

SCHEMA: Final = 1  # Number of the format
SAME_STEP: Final = 1e-6  # Largest difference of the same step on other machines and versions [half ranges]
DIGITS: Final = 9  # Significant digits with which the steps of a nominal map are written
LARGEST_MODEL: Final = 2**26  # Largest model file that is read [bytes]
MAP: Final = "map"  # Name of the source of nominal next states that is a map


@final
@dataclass(frozen=True, eq=False)
class NominalSource:
    """Where the nominal next states of steps are from, whose error a residual predicts.

    Attributes:
        name: `MAP` for a nominal map, otherwise that of a column of the log, such as `target`.
        step_map: The nominal map; None for another source.
    """

    name: str
    step_map: StepMap | None = None

    def __post_init__(self) -> None:
        require((self.name == MAP) == (self.step_map is not None), "name", self.name, f"be {MAP!r} if there is a map")


def model_path(folder: Path, iteration: int) -> Path:
    """Path of the model with which a deployment of a run began; raises InputError if its folder is a link."""
    return own_folder(folder, "models") / f"iteration_{iteration}.json"


class Model(NamedTuple):
    """What is known of the error of a nominal map before a deployment.

    Attributes:
        residual: The residual; with the name `posterior`, that which the beliefs say.
        beliefs: The beliefs; None for a residual without.
    """

    residual: Residual
    beliefs: Beliefs | None


def write_model(folder: Path, iteration: int, model: Model, nominal: StepMap) -> None:
    """Writes what is known before a deployment, and what identifies its nominal map, into the run folder."""
    text = saved_model_text(model.residual, nominal.space, NominalSource(MAP, nominal), model.beliefs)
    write_whole(model_path(folder, iteration), text)


def saved_model_text(
    residual: Residual, space: StepSpace, nominal: NominalSource, beliefs: Beliefs | None = None
) -> str:
    """Content of the model file of a residual.

    Args:
        residual: The residual.
        space: Names and units of its state and command.
        nominal: Source of the nominal next states whose error it predicts.
        beliefs: From which a deployment goes on learning.

    Raises:
        ResidualError: What a regression saves cannot be written as JSON.
    """
    names = {
        key: [[quantity.name, quantity.unit] for quantity in quantities]
        for key, quantities in (("state", space.state), ("command", space.command))
    }
    steps = {"nominal_steps": _steps_of(nominal.step_map)} if nominal.step_map is not None else {}
    with naming_model(residual.model):
        believed = {} if beliefs is None else {"beliefs": beliefs_to_dict(beliefs)}
        parts = {"schema": SCHEMA, **names, "nominal": nominal.name, **steps, **residual.to_dict(), **believed}
        return json.dumps(parts)


def read_model(folder: Path, iteration: int, space: StepSpace, nominal: StepMap | None = None) -> Model | None:
    """Reads what was known before a deployment; None if no model was saved, as for the nominal map.

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
    data, residual = _parsed(path, text)
    _check_names(path, data, space, "both must be of the same run")
    _check_sizes(path, residual, space)
    if nominal is not None:
        _check_nominal(path, data, nominal)
    return Model(residual, _beliefs(path, data, residual))


def _beliefs(path: Path, data: Mapping[str, Any], residual: Residual) -> Beliefs | None:
    """The beliefs in a model file; raises ValueError with one line if they are damaged."""
    if data.get("beliefs") is None:
        return None
    try:
        return beliefs_from_dict(as_object(data["beliefs"], "beliefs"), residual.sizes)
    except (ArithmeticError, LookupError, TypeError, ValueError) as error:
        short = " ".join(str(error).split())[:120]
        raise ValueError(f"{path}: not a model ({short}); it must be one that a run wrote") from None


def read_saved_model(path: Path, space: StepSpace, nominal: NominalSource) -> Residual:
    """Reads the residual of a model file that is used for other steps than those of its run.

    Args:
        path: A file that a run or `stepgap fit --save` wrote.
        space: State and command of these steps; an empty unit is unknown, and agrees with every other.
        nominal: Source of their nominal next states.

    Raises:
        ValueError: The file is not a model, or not one of such steps; the message is one line.
        OSError: It cannot be read.
    """
    text = read_text(path, LARGEST_MODEL)
    if text is None:
        raise ValueError(f"{path}: No such file or directory; give a model file of a run or of `stepgap fit --save`")
    data, residual = _parsed(path, text)
    if not (_names_in(data.get("state")) and _names_in(data.get("command"))):
        raise ValueError(f"{path}: has no names of state and command; write it again with this version")
    remedy = "it is a model of another robot, or name the columns in its order, as NAME=COLUMN"
    _check_names(path, data, space, remedy)
    _check_units(path, data, space)
    _check_sizes(path, residual, space)
    _check_source(path, data, nominal.name)
    if nominal.step_map is not None:
        _check_nominal(path, data, nominal.step_map)
    return residual


def _parsed(path: Path, text: str) -> tuple[Mapping[str, Any], Residual]:
    """Content and residual of a model file; raises ValueError with one line if it has none."""
    try:
        data = _json_in(text)
        if not isinstance(data, dict):
            raise ValueError("not a JSON object")
        if "features" in data or data.get("feature_map", "identity") != "identity":
            raise ValueError("written by a former version; run the experiment again")
        if "format" in data:
            raise ValueError("exported for other programs; give models/iteration_K.json of its run")
        if data.get("schema", SCHEMA) != SCHEMA:
            raise ValueError(f"schema must be {SCHEMA}, not {data['schema']!r:.40}")
        with np.errstate(over="raise", divide="raise", invalid="raise"):
            return data, residual_from_dict(data)
    except (ArithmeticError, AttributeError, LookupError, RecursionError, TypeError, ValueError) as error:
        short = " ".join(str(error).split())[:120]
        raise ValueError(
            f"{path}: not a residual ({short}); it must be one that a run or `stepgap fit --save` wrote"
        ) from None


def _json_in(text: str) -> Any:
    """JSON data; the ValueError of other text is short."""
    try:
        return json.loads(text)
    except json.JSONDecodeError as error:
        raise ValueError(f"not JSON: {error}") from None


def _check_sizes(path: Path, residual: Residual, space: StepSpace) -> None:
    expected = (len(space.state), len(space.command))
    if residual.sizes != expected:
        raise ValueError(
            f"{path}: (state, command) sizes are {residual.sizes}, in steps.csv {expected}; both must be of the same "
            "run"
        )


def _check_names(path: Path, data: Mapping[str, Any], space: StepSpace, remedy: str) -> None:
    """Raises ValueError if the file names other coordinates than the steps; names that it lacks are not compared."""
    for key, names in (("state", space.state_names), ("command", space.command_names)):
        pairs = data.get(key)
        expected = ", ".join(names)
        if pairs is not None and _names_in(pairs) != list(names):
            recorded = ", ".join(_names_in(pairs)) or repr(pairs)
            raise ValueError(f"{path}: its {key} is {recorded:.80}, that of the steps is {expected:.80}; {remedy}")


def _names_in(pairs: Any) -> list[str]:
    """Names in a list of pairs of name and unit; none if it is no such list."""
    return [str(pair[0]) for pair in pairs if isinstance(pair, list) and pair] if isinstance(pairs, list) else []


def _check_units(path: Path, data: Mapping[str, Any], space: StepSpace) -> None:
    for pair, quantity in zip([*data["state"], *data["command"]], (*space.state, *space.command), strict=True):
        unit = pair[1] if len(pair) == 2 else None
        if not isinstance(unit, str):
            raise ValueError(f"{path}: {quantity.name} must be a pair of name and unit, not {pair!r:.80}")
        if unit and quantity.unit and unit != quantity.unit:
            raise ValueError(
                f"{path}: {quantity.name} has the unit {unit!r:.40}, in the steps {quantity.unit!r:.40}; convert the "
                "steps by factors"
            )


def _check_source(path: Path, data: Mapping[str, Any], source: str) -> None:
    recorded = data.get("nominal", MAP)
    if recorded != source:
        raise ValueError(
            f"{path}: learned with '--nominal {recorded!s:.40}', but the nominal next states of the steps are those of "
            f"'--nominal {source}'; they must be of the same source"
        )


def _steps_of(nominal: StepMap) -> list[list[float | None]]:
    """Next states of the nominal map at the middle of the ranges and half-way to the bounds; None for a failed step."""
    steps = nominal.evaluate(*_points(nominal.space)).next_state.tolist()
    return [[float(f"{value:.{DIGITS}g}") if isfinite(value) else None for value in row] for row in steps]


def _points(space: StepSpace) -> tuple[Array, Array]:
    """States and commands of the steps that identify a nominal map."""
    n = len(space.state)
    m = len(space.command)
    offsets = 0.5 * np.vstack([np.zeros(n + m), np.eye(n + m), -np.eye(n + m)])
    return (
        space.state_centre + offsets[:, :n] * space.state_scale,
        space.command_centre + offsets[:, n:] * space.command_scale,
    )


def _check_nominal(path: Path, data: Mapping[str, Any], nominal: StepMap) -> None:
    """Raises ValueError unless the nominal map takes the steps in the file."""
    _check_source(path, data, MAP)
    try:
        recorded = np.array(data["nominal_steps"], float)
    except (KeyError, OverflowError, TypeError, ValueError):
        raise ValueError(f"{path}: has no steps of its nominal map; run the experiment again") from None
    here = nominal.evaluate(*_points(nominal.space)).next_state
    if recorded.shape != here.shape:
        difference = f"its file has {recorded.shape} numbers of steps, this version compares {here.shape}"
    elif not (difference := _difference(recorded, here, nominal.space)):
        return
    raise ValueError(
        f"{path}: was learned on another nominal map: {difference}; use the nominal map and the settings of its run"
    )


def _difference(recorded: Array, here: Array, space: StepSpace) -> str:
    """The largest difference of steps (k, n), with its coordinate, its step and its tolerance; empty if all agree."""
    allowed = SAME_STEP * space.state_scale + 10.0 ** (1 - DIGITS) * np.abs(here)  # also that of the rounded numbers
    same = np.isclose(recorded, here, rtol=0, atol=np.where(np.isfinite(allowed), allowed, 0.0), equal_nan=True)
    if same.all():
        return ""
    with np.errstate(over="ignore"):  # a recorded number may be anything
        excess = np.abs(recorded - here) / allowed
    row, column = np.unravel_index(np.argmax(np.where(same, -1.0, np.nan_to_num(excess, nan=np.inf))), same.shape)
    point = zip(space.names, np.hstack([part[row] for part in _points(space)]), strict=True)
    quantity = space.state[column]
    number = f".{DIGITS}g"
    texts = [
        f"{value:{number}} {quantity.unit}".rstrip() if isfinite(value) else "none (the step fails)"
        for value in (recorded[row, column], here[row, column])
    ]
    limit = f"; they may differ by {allowed[row, column]:.1g} {quantity.unit}".rstrip()
    return (
        f"at {', '.join(f'{name} {value:.8g}' for name, value in point)} its next {quantity.name} was {texts[0]}, "
        f"that of this map is {texts[1]}{limit if isfinite(excess[row, column]) else ''}"
    )

"""Reads a documented model back, as the controller that it was written from."""

import json
from collections.abc import Mapping
from math import inf
from pathlib import Path
from typing import Any, Final

import numpy as np

from stepgap.base.errors import InputError, message_of
from stepgap.base.json_data import as_object, boolean, integer, number, numbers, objects
from stepgap.control.settings import ControlSettings
from stepgap.export.controller.model_document import FORMAT, MODEL_SCHEMA, model_document
from stepgap.export.controller.passport import checked_robot_name
from stepgap.export.controller.portable_controller import PortableController
from stepgap.learning.beliefs import Beliefs
from stepgap.learning.beliefs_data import beliefs_from_dict
from stepgap.learning.observations import Observations
from stepgap.learning.residual import Residual
from stepgap.learning.residual_fit import residual_from_dict
from stepgap.records.summary import read_text
from stepgap.robots.nominal_maps.affine_map import AffineMap
from stepgap.robots.nominal_maps.surrogate_map import Samples, SurrogateMap
from stepgap.step import Array, Quantity, StepMap, StepSpace, StepStatus

LARGEST_PORTABLE: Final = 2**28  # Largest model file that is read [bytes]
LARGEST_DEGREE: Final = 10  # Largest total degree of a nominal map that is read

SAME_NUMBERS: Final = 1e-6
"""Relative difference of numbers that another processor or version computes from the same data."""


def read_portable(path: Path) -> PortableController:
    """Reads the controller of a model file.

    Args:
        path: The file that `stepgap export RUN --to model` wrote.

    Raises:
        InputError: It is not such a file, of another schema, or its numbers do not follow from its data.
    """
    try:
        text = read_text(path, LARGEST_PORTABLE)
        if text is None:
            raise InputError(f"{path}: there is no such file; give one of `stepgap export RUN --to model`")
        saved = json.loads(text)
        if not isinstance(saved, dict) or saved.get("format") != FORMAT:
            raise ValueError(f'format must be "{FORMAT}"')
        if saved.get("schema") in range(1, MODEL_SCHEMA):
            raise ValueError(f"schema is {saved['schema']}, that of a former version, and not {MODEL_SCHEMA}")
        if saved.get("schema") != MODEL_SCHEMA:
            raise ValueError(f"schema must be {MODEL_SCHEMA}, not {saved.get('schema')!r:.40}")
        controller = _controller(saved)
        _check_same(saved, model_document(controller))
    except InputError:
        raise
    except OSError as error:
        raise InputError(message_of(error)) from None
    except (ArithmeticError, AttributeError, LookupError, RecursionError, TypeError, ValueError) as error:
        short = " ".join(str(error).split())[:160]
        raise InputError(f"{path}: not a model file ({short}); export the run again") from None
    return controller


def _controller(saved: Mapping[str, Any]) -> PortableController:
    is_lagged = "lagged" in saved and boolean(saved, "lagged")
    seconds = number(saved, "planar_seconds") if "planar_seconds" in saved else 0.0
    groups = _quantities(saved, "state"), _quantities(saved, "command")
    space = StepSpace(*groups, is_lagged=is_lagged, planar_seconds=seconds)
    control = as_object(saved["control"], "control")
    beliefs = None if saved["beliefs"] is None else as_object(saved["beliefs"], "beliefs")
    return PortableController(
        _nominal(space, as_object(saved["nominal"], "nominal")),
        _residual(space, as_object(saved["residual"], "residual")),
        None if beliefs is None else _beliefs(space, beliefs),
        _points(saved, "failures", len(saved["failures"]), len(space.names)),
        ControlSettings(
            cautious=boolean(control, "cautious"),
            viability=boolean(control, "viability"),
            avoid_failures=boolean(control, "avoid_failures"),
            evaluations=integer(control, "evaluations"),
            horizon=integer(control, "horizon"),
            largest_change=number(control, "largest_change"),
            surprise=inf if control["surprise"] is None else number(control, "surprise"),
            make_up=integer(control, "make_up", 0),
        ),
        farthest=None if control["farthest"] is None else _sized(control, "farthest", len(space.command)),
        steps=None if beliefs is None else _steps(space, as_object(beliefs["steps"], "beliefs.steps")),
        notes=tuple(map(str, (*saved["approximations"], *saved["notes"]))),
        passport=_passport(saved.get("passport", {})),
    )


def _passport(saved: Any) -> dict[str, Any]:
    """A passport, whose name can be printed; its other entries are as they are."""
    passport = as_object(saved, "passport")
    name = passport.get("name", "")
    if not isinstance(name, str):
        raise ValueError(f"passport.name must be a text, not {name!r:.40}")
    try:
        checked_robot_name(name)
    except InputError as error:
        raise ValueError(f"passport: {error}") from None
    return passport


def _quantities(saved: Mapping[str, Any], key: str) -> tuple[Quantity, ...]:
    return tuple(
        Quantity(
            name=str(quantity["name"]),
            unit=str(quantity["unit"]),
            lower=number(quantity, "lower"),
            upper=number(quantity, "upper"),
            weight=number(quantity, "weight") if key == "state" else 1.0,
        )
        for quantity in objects(saved, key, "quantities")
    )


def _nominal(space: StepSpace, saved: Mapping[str, Any]) -> StepMap:
    n = len(space.state)
    m = len(space.command)
    if saved["kind"] == "affine":
        return AffineMap(
            space,
            _sized(saved, "state", n),
            _sized(saved, "command", m),
            _sized(saved, "next_state", n),
            _sized(saved, "matrix", n, n + m),
        )
    if saved["kind"] != "legendre":
        raise ValueError(f'nominal.kind must be "affine" or "legendre", not {saved["kind"]!r:.40}')
    degree = int(numbers(saved, "degrees", 2).max())
    if degree > LARGEST_DEGREE:
        raise ValueError(f"nominal.degrees must be at most {LARGEST_DEGREE}")
    return SurrogateMap(
        space,
        _sized(saved, "centre", n + m),
        _sized(saved, "scale", n + m),
        degree,
        _sized(saved, "weights", len(saved["degrees"]), n),
        _sized(saved, "error", n),
        _samples(saved["samples"], n, n + m),
    )


def _samples(saved: Mapping[str, Any], n: int, d: int) -> Samples:
    """The sampled steps; their next states are not in the file, since only those that failed matter."""
    status = np.array(saved["status"], np.int64)
    if not np.isin(status, [int(status) for status in StepStatus]).all():
        raise ValueError("nominal.samples.status must be status codes")
    return Samples(_points(saved, "points", len(status), d), np.full((len(status), n), np.nan), status)


def _residual(space: StepSpace, saved: Mapping[str, Any]) -> Residual:
    return residual_from_dict({
        "kind": saved["kind"],
        "command_size": len(space.command),
        "forgetting_time": None,
        "regressions": [regression["data"] for regression in saved["regressions"]],
    })  # fmt: skip


def _beliefs(space: StepSpace, saved: Mapping[str, Any]) -> Beliefs:
    beliefs = beliefs_from_dict(saved, (len(space.state), len(space.command)))
    if beliefs.features.inputs != len(space.names):
        raise ValueError(f"beliefs.features.inputs must be {len(space.names)}")
    return beliefs


def _steps(space: StepSpace, saved: Mapping[str, Any]) -> Observations:
    n = len(space.state)
    m = len(space.command)
    count = len(saved["state"])
    return Observations(
        space,
        _points(saved, "state", count, n),
        _points(saved, "command", count, m),
        _points(saved, "error", count, n),
    )


def _points(saved: Mapping[str, Any], key: str, count: int, d: int) -> Array:
    """The points under a key; an empty list has no columns."""
    return _sized(saved, key, count, d) if saved[key] else np.empty((0, d))


def _sized(saved: Mapping[str, Any], key: str, *shape: int) -> Array:
    """The array of finite numbers under a key, of this shape.

    Raises:
        KeyError: There is no such key.
        ValueError: It has another shape, or numbers that are not finite.
    """
    array = np.asarray(saved[key], float)
    if array.shape != shape or not np.isfinite(array).all():
        raise ValueError(f"{key} must be finite numbers of shape {shape}, not {array.shape}")
    return array


def _check_same(saved: Any, computed: Any, where: str = "") -> None:
    """Raises ValueError where the file's numbers are not those that follow from its data."""
    if isinstance(computed, dict):
        for key, value in computed.items():
            if key not in ("stepgap", "passport", "approximations", "notes"):
                _check_same(saved[key], value, f"{where}.{key}" if where else key)
    elif isinstance(computed, list) and computed and isinstance(computed[0], dict):
        if not isinstance(saved, list) or len(saved) != len(computed):
            raise ValueError(f"{where} must have {len(computed)} entries")
        for index, value in enumerate(computed):
            _check_same(saved[index], value, f"{where}[{index}]")
    elif isinstance(computed, list | float):
        array = np.asarray(saved, float)
        expected = np.asarray(computed, float)
        scale = np.abs(expected).max(initial=0.0)
        if array.shape != expected.shape or not np.allclose(array, expected, rtol=0, atol=SAME_NUMBERS * scale):
            raise ValueError(f"{where} does not follow from the data")
    elif saved != computed:
        raise ValueError(f"{where} must be {computed!r}, not {saved!r:.40}")

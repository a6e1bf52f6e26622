"""Files of priors over robots: readable JSON, with what the prior was found from."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, final

import numpy as np

from stepgap.base.errors import message_of
from stepgap.base.files import read_bounded_text
from stepgap.base.json_data import LARGEST_NUMBER, as_object, number, numbers, objects, parse_json
from stepgap.gauss.features import Features
from stepgap.gauss.monomials import monomials
from stepgap.learning.prior import DEGREE, CoordinatePrior, Prior
from stepgap.step import Array, StepSpace

LARGEST_PRIOR = 2**24  # Largest file of a prior that is read [bytes]
_FORMAT = "stepgap prior 1"  # Value of the key `format`
_LEAST_SCALE = 1e-9  # Smallest scale of an input and smallest noise that is read

_LEAST_CONDITION = 1e-13
"""Smallest eigenvalue of the information of a prior, relative to its largest one or to that of some steps."""

_DIGITS = 8  # Significant digits of the numbers


@final
@dataclass(frozen=True, eq=False)
class PriorFile:
    """A prior with its provenance.

    Attributes:
        prior: The prior.
        robot: Name of the robots.
        nominal: Kind of nominal map whose errors they are.
        provenance: How it was found, as JSON data.
    """

    prior: Prior
    robot: str
    nominal: str
    provenance: Mapping[str, Any]

    def text(self) -> str:
        """The file. Means and covariances are in half ranges of the state coordinate."""
        prior = self.prior
        ranges = zip(prior.names, prior.centre, prior.scale, strict=True)
        content = {
            "format": _FORMAT,
            "robot": self.robot,
            "nominal": self.nominal,
            "provenance": dict(self.provenance),
            "inputs": [{"name": name, "centre": float(middle), "scale": float(half)} for name, middle, half in ranges],
            "monomials": _names_of_monomials(prior.names),
            "coordinates": [
                {
                    "name": name,
                    "noise_std": _rounded(coordinate.noise_std),
                    "mean": _rounded(coordinate.mean),
                    "covariance": _rounded(coordinate.covariance),
                }
                for name, coordinate in zip(prior.names, prior.coordinates, strict=False)
            ],
        }
        return json.dumps(content, indent=1, ensure_ascii=False) + "\n"


def read_prior(path: Path, space: StepSpace) -> PriorFile:
    """Reads a prior for a robot with this state and command.

    Raises:
        OSError: The file cannot be read.
        ValueError: It is not a prior, or that of another state and command; the message names the file.
    """
    try:
        data = as_object(parse_json(read_bounded_text(path, LARGEST_PRIOR)), "a prior")
        if data.get("format") != _FORMAT:
            raise ValueError(f"format must be {_FORMAT!r}; `stepgap prior` writes such a file")
        return _restored(data, space)
    except ValueError as error:
        raise ValueError(f"{path}: {message_of(error).removeprefix(f'{path}: ')}") from None


def _restored(data: Mapping[str, Any], space: StepSpace) -> PriorFile:
    inputs = objects(data, "inputs", "inputs")
    saved = objects(data, "coordinates", "coordinates")
    names = _names_in(inputs)
    of_state = _names_in(saved)
    if names != space.names:
        raise ValueError(f"it is for {', '.join(names):.200}, but this robot has {', '.join(space.names)}")
    if of_state != space.state_names:
        raise ValueError(f"coordinates must have the names {', '.join(space.state_names)}, in this order")
    monomial_names = _names_of_monomials(names)
    if data.get("monomials") != monomial_names:
        raise ValueError(f"monomials must be {', '.join(monomial_names):.200}, in this order")
    centre, scale = (np.array([number(entry, key) for entry in inputs]) for key in ("centre", "scale"))
    _check_size(centre, "inputs: centre")
    _check_size(scale, "inputs: scale", least=_LEAST_SCALE)
    coordinates = tuple(_coordinate(entry, len(monomial_names)) for entry in saved)
    robot, nominal = (str(data.get(key, "")) for key in ("robot", "nominal"))
    provenance = as_object(data.get("provenance", {}), "provenance")
    prior = Prior(names, centre, scale, coordinates)
    _check_condition(prior, space)
    return PriorFile(prior, robot, nominal, provenance)


def _coordinate(data: Mapping[str, Any], size: int) -> CoordinatePrior:
    coordinate = CoordinatePrior(numbers(data, "mean", 1), numbers(data, "covariance", 2), number(data, "noise_std"))
    covariance = coordinate.covariance
    if coordinate.mean.shape != (size,) or covariance.shape != (size, size):
        raise ValueError(f"coordinates: mean and covariance must have {size} numbers and rows, one for each monomial")
    if not np.array_equal(covariance, covariance.T) or np.linalg.eigvalsh(covariance)[0] <= 0:
        raise ValueError("coordinates: covariance must be symmetric and positive definite")
    _check_size(coordinate.mean, "coordinates: mean")
    _check_size(covariance, "coordinates: covariance")
    _check_size(np.array(coordinate.noise_std), "coordinates: noise_std", least=_LEAST_SCALE)
    return coordinate


def _check_condition(prior: Prior, space: StepSpace) -> None:
    """Raises ValueError if numbers are so different in size that weights cannot be solved for in this space."""
    inputs = len(space.names)
    features = Features(inputs, DEGREE, frequencies=np.empty((0, inputs)), shifts=np.empty(0))
    with np.errstate(all="ignore"):
        family = prior.family(space, features)
    for name, covariance, noise in zip(space.state_names, family.covariance, family.noise_std, strict=True):
        with np.errstate(all="ignore"):
            shares = covariance / noise**2
        values = np.linalg.eigvalsh(shares) if np.isfinite(shares).all() else np.zeros(1)
        least = _LEAST_CONDITION * max(values[-1], 1.0)
        if values[0] <= least or values[-1] * len(shares) >= 1 / _LEAST_CONDITION:
            raise ValueError(
                f"coordinates: {name}: noise_std, covariance, and centre and scale of the inputs do not fit each other "
                "or the ranges of this robot: their sizes differ by too many powers of ten"
            )


def _check_size(values: Array, name: str, least: float = -LARGEST_NUMBER) -> None:
    """Raises ValueError if a number is so large or small that products of such numbers are none."""
    if not ((least <= values) & (np.abs(values) <= LARGEST_NUMBER)).all():
        raise ValueError(f"{name} must lie between {least:g} and {LARGEST_NUMBER:g}")


def _names_in(items: Sequence[Mapping[str, Any]]) -> tuple[str, ...]:
    """Names of the entries of a list, as far as they can be printed."""
    return tuple("".join(filter(str.isprintable, str(item.get("name")))) for item in items)


def _names_of_monomials(names: tuple[str, ...]) -> list[str]:
    """What each weight is multiplied by, in the order of `monomials`."""
    i, j = np.triu_indices(len(names))
    products = ["1", *names, *(f"{names[a]} {names[b]}" for a, b in zip(i, j, strict=True))]
    return products[: monomials(np.zeros(len(names)), DEGREE).size]


def _rounded(values: Array | float) -> Any:
    """Numbers with `_DIGITS` significant digits, as JSON data."""
    return np.vectorize(lambda value: float(f"{value:.{_DIGITS}g}"))(np.asarray(values, float)).tolist()

"""The seam for residual models: the error of the nominal map, actual − nominal (Eq. 12).

A residual takes points, which are a state and a command side by side; shape (…, n + m).
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, final

import numpy as np
from numpy.typing import ArrayLike

from stepgap.learning.gaussian_process import GaussianProcess
from stepgap.learning.gaussian_process_fit import fit_gaussian_process, fit_like_fitrgp
from stepgap.learning.settings import KINDS, GaussianProcessKind, ResidualKind
from stepgap.step import Array, StepSpace


class Residual(ABC):
    """Predicts actual − nominal of the next state.

    A subclass gives the sizes n and m, the mean with its gradient, the standard deviation, and the
    plain data that `residual_from_dict` reads.
    """

    @property
    @abstractmethod
    def sizes(self) -> tuple[int, int]:
        """Number of state coordinates n and of command coordinates m."""

    @abstractmethod
    def mean(self, point: ArrayLike) -> Array:
        """Expected residual; shape (…, n) [units of the state]."""

    @abstractmethod
    def mean_gradient(self, point: ArrayLike) -> Array:
        """∂mean/∂(state, command); shape (…, n, n + m)."""

    @abstractmethod
    def std(self, point: ArrayLike, *, include_noise: bool = False) -> Array:
        """Standard deviation of the residual; shape (…, n) [units of the state].

        Args:
            point: Shape (…, n + m).
            include_noise: False: of the residual itself. True: of one measured step's residual.
        """

    @abstractmethod
    def to_dict(self) -> dict[str, Any]:
        """JSON-ready data with the `kind` of the residual."""


@final
@dataclass(frozen=True)
class NoResidual(Residual):
    """The nominal map as it is: zero, and sure of it.

    Attributes:
        state_size: n.
        command_size: m.
    """

    state_size: int
    command_size: int

    @property
    def sizes(self) -> tuple[int, int]:
        """As given."""
        return self.state_size, self.command_size

    def mean(self, point: ArrayLike) -> Array:
        """Zero; shape (…, n)."""
        return np.zeros((*np.shape(point)[:-1], self.state_size))

    def mean_gradient(self, point: ArrayLike) -> Array:
        """Zero; shape (…, n, n + m)."""
        return np.zeros((*np.shape(point)[:-1], self.state_size, self.state_size + self.command_size))

    def std(self, point: ArrayLike, *, include_noise: bool = False) -> Array:  # noqa: ARG002
        """Zero; shape (…, n)."""
        return self.mean(point)

    def to_dict(self) -> dict[str, Any]:
        """The sizes."""
        return {"kind": "none", "state_size": self.state_size, "command_size": self.command_size}


@final
@dataclass(frozen=True, eq=False)
class GaussianProcessResidual(Residual):
    """One independent Gaussian process per state coordinate.

    Attributes:
        kind: `gp` reports universal-kriging standard deviations, `fitrgp` plug-in ones.
        processes: One for each of the n state coordinates, each of n + m inputs.
    """

    kind: GaussianProcessKind
    processes: tuple[GaussianProcess, ...]

    def __post_init__(self) -> None:
        inputs = {process.points.shape[1] for process in self.processes}
        if len(inputs) != 1 or not min(inputs) > len(self.processes):
            raise ValueError(
                f"{len(self.processes)} processes must share more inputs than they are, the state and a command: "
                f"they have {sorted(inputs)}"
            )

    @property
    def sizes(self) -> tuple[int, int]:
        """As the processes have them."""
        return len(self.processes), self.processes[0].points.shape[1] - len(self.processes)

    def mean(self, point: ArrayLike) -> Array:
        """Expected residual; shape (…, n) [units of the state]."""
        return np.stack([process.mean(point) for process in self.processes], axis=-1)

    def mean_gradient(self, point: ArrayLike) -> Array:
        """∂mean/∂(state, command); shape (…, n, n + m)."""
        return np.stack([process.mean_gradient(point) for process in self.processes], axis=-2)

    def std(self, point: ArrayLike, *, include_noise: bool = False) -> Array:
        """Standard deviation, of the sort that belongs to `kind`; shape (…, n) [units of the state]."""
        if self.kind == "gp":
            stds = [process.kriging_std(point, include_noise=include_noise) for process in self.processes]
        else:
            stds = [process.std(point, include_noise=include_noise) for process in self.processes]
        return np.stack(stds, axis=-1)

    def to_dict(self) -> dict[str, Any]:
        """The processes, coordinate by coordinate."""
        return {"kind": self.kind, "processes": [process.to_dict() for process in self.processes]}


def fit_residual(
    kind: ResidualKind, space: StepSpace, state: ArrayLike, applied_command: ArrayLike, error: ArrayLike
) -> Residual:
    """Fit a model of the nominal map's error to recorded steps (Eq. 12).

    Args:
        kind: Which model.
        space: Names the coordinates, and gives the fixed scales in which length scales are measured.
        state: State at the apex each step started from; shape (N, n).
        applied_command: Command the joints received; shape (N, m).
        error: Actual − nominal next state; shape (N, n).

    Raises:
        ValueError: An unknown kind, a wrong shape, or a number that is not finite.
    """
    if kind not in KINDS:
        raise ValueError(f"unknown residual {kind!r}; use one of {', '.join(KINDS)}")
    state = _rows(state, "state", space.state_names)
    applied_command = _rows(applied_command, "applied_command", space.command_names)
    error = _rows(error, "error", space.state_names)
    if not len(state) == len(applied_command) == len(error):
        raise ValueError(f"{len(state)} states, {len(applied_command)} applied commands and {len(error)} errors")
    points = join_points(state, applied_command)
    if kind == "none":
        return NoResidual(len(space.state), len(space.command))
    if not len(points):
        raise ValueError(f"residual {kind!r} needs at least one step")
    if kind == "fitrgp":
        return GaussianProcessResidual(kind, tuple(fit_like_fitrgp(points, values) for values in error.T))
    scale = np.concatenate([space.state_scale, space.command_scale])
    return GaussianProcessResidual(kind, tuple(fit_gaussian_process(points, values, scale) for values in error.T))


def residual_from_dict(data: Mapping[str, Any]) -> Residual:
    """The residual that `to_dict` saved.

    Raises:
        ValueError: A key is missing or holds something else than it should; the message names it.
    """
    if data.get("kind") not in KINDS:
        raise ValueError(f"kind must be one of {', '.join(KINDS)}, not {data.get('kind')!r}")
    if data["kind"] == "none":
        return NoResidual(_size(data, "state_size"), _size(data, "command_size"))
    saved = data.get("processes")
    if not isinstance(saved, list) or not saved:
        raise ValueError("processes must be a list of one Gaussian process per state coordinate")
    return GaussianProcessResidual(
        data["kind"], tuple(_process(item, f"processes[{i}]") for i, item in enumerate(saved))
    )


def join_points(state: ArrayLike, command: ArrayLike) -> Array:
    """State (…, n) and command (…, m), broadcast over their leading axes, side by side; shape (…, n + m)."""
    state, command = np.asarray(state, float), np.asarray(command, float)
    leading = np.broadcast_shapes(state.shape[:-1], command.shape[:-1])
    parts = [np.broadcast_to(part, (*leading, part.shape[-1])) for part in (state, command)]
    return np.concatenate(parts, axis=-1)


def _rows(array: ArrayLike, name: str, columns: tuple[str, ...]) -> Array:
    array = np.asarray(array, float)
    if array.ndim != 2 or array.shape[1] != len(columns):
        raise ValueError(f"{name} must have the columns {', '.join(columns)}, not the shape {array.shape}")
    if not np.isfinite(array).all():
        row = int(np.flatnonzero(~np.isfinite(array).all(axis=1))[0])
        raise ValueError(f"{name} must be finite, but row {row} is {array[row].tolist()}; leave failed steps out")
    return array


def _size(data: Mapping[str, Any], key: str) -> int:
    value = data.get(key)
    if not isinstance(value, int) or isinstance(value, bool) or value < 1:
        raise ValueError(f"{key} must be a positive whole number, not {value!r}")
    return value


def _process(saved: object, where: str) -> GaussianProcess:
    if not isinstance(saved, Mapping):
        raise ValueError(f"{where} must be a Gaussian process, not {saved!r:.40}")
    try:
        return GaussianProcess.from_dict(saved)
    except ValueError as error:
        raise ValueError(f"{where}.{error}") from error

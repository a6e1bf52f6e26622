"""The residual: a model of the error of the nominal map, actual − nominal (Eq. 12)."""

from dataclasses import dataclass, replace
from math import inf, isfinite
from typing import Any, final

import numpy as np
from numpy.typing import ArrayLike

from stepgap.base.ranges import require
from stepgap.learning.regression import Regression, ResidualModel
from stepgap.learning.residual_check import ResidualError
from stepgap.learning.zero import NONE, Zero
from stepgap.step import Array


@final
@dataclass(frozen=True)
class HistoryInputs:
    """Inputs of a residual besides state and command.

    Attributes:
        forgetting_time: Number of steps T in which the influence of a step falls to 1/e: polynomials weight it by
            exp(−age/T), and a Gaussian process has the time as an input with length scale T; inf: it never falls.
        context_inputs: Number of context inputs at the end of the history, all of which are inputs.
    """

    forgetting_time: float = inf
    context_inputs: int = 0

    def __post_init__(self) -> None:
        require(
            self.forgetting_time > 0, "forgetting_time", self.forgetting_time, "be a positive number of steps, or inf"
        )

    @property
    def timed(self) -> bool:
        """Whether the last input is the time, in forgetting times."""
        return isfinite(self.forgetting_time)

    @property
    def count(self) -> int:
        """Number of these inputs, c."""
        return self.context_inputs + self.timed

    def of(self, history: Array) -> Array:
        """The inputs from a history, as `observations` defines it; (…, 1 + q) to (…, c). The time is the last one."""
        time = history[..., :1] / self.forgetting_time
        return np.concatenate([history[..., 1:], time[..., : int(self.timed)]], axis=-1)


@final
@dataclass(frozen=True, eq=False, repr=False)
class Residual:
    """Predicts actual − nominal of the next state, with one regression for each coordinate.

    A point is the concatenation of a state and a command, shape (…, n + m). A residual with history inputs must first
    be conditioned on the history of the step, by `conditioned_on`: then it is a function of points again.

    Attributes:
        model: Model of the regressions.
        regressions: One for each of the n state coordinates, with the same n + m + c inputs.
        command_size: m.
        history_inputs: Which c inputs there are besides state and command.
        history_values: The values of those c inputs; None until they are known.

    Raises:
        ResidualError: The model made something else than a regression.
        ValueError: The number of inputs is not that of state, command and history inputs.
    """

    model: ResidualModel
    regressions: tuple[Regression, ...]
    command_size: int
    history_inputs: HistoryInputs = HistoryInputs()
    history_values: Array | None = None

    def __repr__(self) -> str:
        return f"<Residual '{self.model.name}' of {len(self.regressions)} state coordinates>"

    def __post_init__(self) -> None:
        for regression in self.regressions:
            if not isinstance(regression, Regression):
                raise ResidualError(f"residual '{self.kind}': made {regression!r:.40}; it must make a Regression")
        n, m = self.sizes
        c = self.history_inputs.count
        inputs = sorted({regression.inputs for regression in self.regressions})
        if m < 1 or inputs != [n + m + c]:
            raise ValueError(
                f"{n} regressions, one per state coordinate, must have {n + m + c} inputs, that is state, a command of "
                f"size {m} and {c} history inputs: they have {inputs}"
            )

    @property
    def sizes(self) -> tuple[int, int]:
        """Number of state coordinates n and of command coordinates m."""
        return len(self.regressions), self.command_size

    @property
    def kind(self) -> str:
        """Name of the model."""
        return self.model.name

    def conditioned_on(self, history: Array) -> "Residual":
        """Returns the residual of the step with this history (1 + q,), a function of state and command."""
        if self.history_inputs == HistoryInputs():
            return self
        return replace(self, history_values=self.history_inputs.of(np.asarray(history, float)))

    def mean(self, point: ArrayLike) -> Array:
        """Expected residual; shape (…, n) [units of the state]."""
        inputs = self._inputs(point)
        return np.stack([regression.mean(inputs) for regression in self.regressions], axis=-1)

    def mean_gradient(self, point: ArrayLike) -> Array:
        """∂mean/∂(state, command); shape (…, n, n + m)."""
        inputs = self._inputs(point)
        gradient = np.stack([regression.mean_gradient(inputs) for regression in self.regressions], axis=-2)
        return gradient[..., : sum(self.sizes)]

    @property
    def noise_std(self) -> Array:
        """Standard deviation of one measured step's residual about the expected one; shape (n,)."""
        return np.array([regression.noise_std for regression in self.regressions])

    def std(self, point: ArrayLike, *, include_noise: bool = False) -> Array:
        """Standard deviation of the residual; shape (…, n) [units of the state].

        Args:
            point: Shape (…, n + m).
            include_noise: False: of the latent function f*. True: of a measured value y* (Rasmussen & Williams,
                Sec. 2.2).
        """
        inputs = self._inputs(point)
        std = np.stack([regression.std(inputs) for regression in self.regressions], axis=-1)
        return np.hypot(std, self.noise_std) if include_noise else std

    def std_gradient(self, point: ArrayLike) -> Array:
        """∂std/∂(state, command) of the latent function; shape (…, n, n + m)."""
        inputs = self._inputs(point)
        gradients = [regression.std_gradient(inputs) for regression in self.regressions]
        return np.stack(gradients, axis=-2)[..., : sum(self.sizes)]

    def append(self, point: ArrayLike, error: ArrayLike) -> "Residual":
        """Learns one more step, with the history it is conditioned on, at the same hyper-parameters.

        Args:
            point: State and requested command of the step; shape (n + m,).
            error: Actual − nominal next state; shape (n,).
        """
        inputs = self._inputs(point)
        values = np.asarray(error, float)
        pairs = zip(self.regressions, values, strict=True)
        return replace(self, regressions=tuple(regression.append(inputs, float(value)) for regression, value in pairs))

    def to_dict(self) -> dict[str, Any]:
        """Converts the residual to JSON-ready data, which `residual_from_dict` reads; `history_values` is not kept."""
        count = self.history_inputs.context_inputs
        return {
            "kind": self.kind,
            "command_size": self.command_size,
            "forgetting_time": self.history_inputs.forgetting_time if self.history_inputs.timed else None,
            **({"context_inputs": count} if count else {}),
            "regressions": [regression.to_dict() for regression in self.regressions],
        }

    def _inputs(self, point: ArrayLike) -> Array:
        """Points with their history inputs; shape (…, n + m + c)."""
        point = np.asarray(point, float)
        if self.history_values is None:
            if self.history_inputs != HistoryInputs():
                raise ValueError("this residual has history inputs: condition it on the history of the step first")
            return point
        return join_points(point, self.history_values)


def no_residual(state_size: int, command_size: int) -> Residual:
    """Returns the residual that is zero: it does not correct the nominal map."""
    return Residual(NONE, (Zero(state_size + command_size),) * state_size, command_size)


def join_points(state: ArrayLike, command: ArrayLike) -> Array:
    """Concatenates states (…, n) and commands (…, m), which broadcast over their leading axes; shape (…, n + m)."""
    state = np.asarray(state, float)
    command = np.asarray(command, float)
    n = state.shape[-1]
    m = command.shape[-1]
    leading = np.broadcast(state[..., :1], command[..., :1]).shape[:-1]
    points = np.empty((*leading, n + m))
    points[..., :n] = state
    points[..., n:] = command
    return points

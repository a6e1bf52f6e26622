"""The residual: a model of the error of the nominal map, actual − nominal (Eq. 12)."""

from dataclasses import dataclass, replace
from math import inf, isfinite
from typing import Any, final

import numpy as np
from numpy.typing import ArrayLike

from stepgap.learning.regression import Regression, Zero
from stepgap.learning.settings import FEATURES, Features
from stepgap.step import Array


@final
@dataclass(frozen=True)
class Hindsight:
    """What of the past a residual takes as inputs, besides state and command.

    Attributes:
        features: What of the step before.
        memory: After how many steps what was learnt counts much less; inf: it counts for ever.
    """

    features: Features = "none"
    memory: float = inf

    def __post_init__(self) -> None:
        if self.features not in FEATURES:
            raise ValueError(f"features = {self.features!r}, but it must be one of {', '.join(FEATURES)}")
        if not self.memory > 0:
            raise ValueError(f"memory = {self.memory}, but it must be a positive number of steps, or inf")

    @property
    def timed(self) -> bool:
        """Whether the last input is the time, in memories."""
        return isfinite(self.memory)

    def inputs(self, context: Array, state_size: int) -> Array:
        """The inputs among the numbers of a context, which `observations` defines; (…, 2n + m + 1) to (…, c)."""
        used = {"none": 0, "previous_error": state_size, "previous_step": context.shape[-1] - 1}[self.features]
        time = context[..., -1:] / self.memory
        return np.concatenate([context[..., :used], time if self.timed else time[..., :0]], axis=-1)


@final
@dataclass(frozen=True, eq=False)
class Residual:
    """Predicts actual − nominal of the next state, each coordinate by a regression of its own.

    A point is a state and a command side by side, shape (…, n + m). A residual with hindsight needs a context,
    too: `given` one, it is a function of points again.

    Attributes:
        regressions: One for each of the n state coordinates, of the same n + m + c inputs.
        command_size: m.
        hindsight: What of the past is among the inputs.
        past: Those c inputs, once given.
    """

    regressions: tuple[Regression, ...]
    command_size: int
    hindsight: Hindsight = Hindsight()
    past: Array | None = None

    def __post_init__(self) -> None:
        n, m = self.sizes
        c = self.hindsight.inputs(np.zeros(2 * n + m + 1), n).size
        inputs = sorted({regression.inputs for regression in self.regressions})
        if m < 1 or inputs != [n + m + c]:
            raise ValueError(
                f"{n} regressions, one per state coordinate, must have {n + m + c} inputs, that state, a command of "
                f"size {m} and {c} of the past: they have {inputs}"
            )

    @property
    def sizes(self) -> tuple[int, int]:
        """Number of state coordinates n and of command coordinates m."""
        return len(self.regressions), self.command_size

    @property
    def kind(self) -> str:
        """Name of the regressions."""
        return self.regressions[0].kind

    @property
    def name(self) -> str:
        """Kind and, if there are any, features, in a few words."""
        features = self.hindsight.features.replace("_", " ")
        return self.kind if features == "none" else f"{self.kind} with {features}"

    def given(self, context: Array) -> "Residual":
        """The residual of the step that has this context (2n + m + 1,), as a function of state and command."""
        if self.hindsight == Hindsight():
            return self
        return replace(self, past=self.hindsight.inputs(np.asarray(context, float), len(self.regressions)))

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
            include_noise: False: of the residual itself. True: of one measured step's residual.
        """
        inputs = self._inputs(point)
        return np.stack([each.std(inputs, include_noise=include_noise) for each in self.regressions], axis=-1)

    def std_gradient(self, point: ArrayLike, *, include_noise: bool = False) -> Array:
        """∂std/∂(state, command); shape (…, n, n + m)."""
        inputs = self._inputs(point)
        gradients = [each.std_gradient(inputs, include_noise=include_noise) for each in self.regressions]
        return np.stack(gradients, axis=-2)[..., : sum(self.sizes)]

    def append(self, point: ArrayLike, error: ArrayLike) -> "Residual":
        """The residual with one more step learnt, in the context given, at the same hyper-parameters.

        Args:
            point: State and applied command of the step; shape (n + m,).
            error: Actual − nominal next state; shape (n,).
        """
        inputs, values = self._inputs(point), np.asarray(error, float)
        pairs = zip(self.regressions, values, strict=True)
        return replace(self, regressions=tuple(each.append(inputs, float(value)) for each, value in pairs))

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready data, which `residual_from_dict` reads; what was given is not kept."""
        return {
            "kind": self.kind,
            "command_size": self.command_size,
            "features": self.hindsight.features,
            "memory": self.hindsight.memory if self.hindsight.timed else None,
            "regressions": [regression.to_dict() for regression in self.regressions],
        }

    def _inputs(self, point: ArrayLike) -> Array:
        """A point with the past; shape (…, n + m + c)."""
        point = np.asarray(point, float)
        if self.past is None:
            if self.hindsight != Hindsight():
                raise ValueError("this residual has hindsight: give it the context of the step first")
            return point
        return join_points(point, self.past)


def no_residual(state_size: int, command_size: int) -> Residual:
    """The nominal map as it is."""
    return Residual((Zero(state_size + command_size),) * state_size, command_size)


def join_points(state: ArrayLike, command: ArrayLike) -> Array:
    """State (…, n) and command (…, m), broadcast over their leading axes, side by side; shape (…, n + m)."""
    state, command = np.asarray(state, float), np.asarray(command, float)
    n, m = state.shape[-1], command.shape[-1]
    leading = np.broadcast(state[..., :1], command[..., :1]).shape[:-1]
    points = np.empty((*leading, n + m))
    points[..., :n], points[..., n:] = state, command
    return points

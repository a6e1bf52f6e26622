"""The learned controller as a filter on a robot: (target, latest state) to the command of the next step.

A `StepFilter` is made from the documented model alone (docs/model_file.md): its maps are the formulas of that file, its
commands those of a run, by the same code. `stepgap export --to python` writes it, with all that it needs and the model,
as one file for NumPy (`python_source`).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, NamedTuple, cast, final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stepgap.control.cautious_controller import CautiousController
from stepgap.control.command_change import CommandChange
from stepgap.control.evaluation_budget import BudgetedMap, EvaluationBudget
from stepgap.control.goal import Targets
from stepgap.control.settings import ControlSettings
from stepgap.control.step_controller import StepController, as_vector, checked_target
from stepgap.export.controller.formulas import INVERSE, nominal_state, regression, scaled_point
from stepgap.learning.residual import Residual, join_points
from stepgap.learning.trust import PredictedStep, Trust
from stepgap.step import Array, Codes, Outcome, Quantity, StepFailed, StepMap, StepSpace, StepStatus

UNCORRECTED: Final = len(StepStatus)
"""Status of a plan without a usable measurement: its command is that of the nominal map if the target is held."""

TINY: Final = 1e-100
"""Imaginary part of an input with which a formula is differentiated: no digit is lost."""


class FilterPlan(NamedTuple):
    """A command, always within its bounds.

    Attributes:
        status: 0: it is planned with the learned map. `UNCORRECTED`: there is no usable measurement, so the command is
            that of the nominal map if the target is held. Another `StepStatus`: how the steps failed that were
            searched; the command is the same then.
        command: Shape (m,).
        predicted: Next state, NaN unless the status is 0; shape (n,).
        std: Standard deviation of the measured next state, NaN unless the status is 0; shape (n,).
    """

    status: int
    command: Array
    predicted: Array
    std: Array


@final
class StepFilter:
    """The controller of one deployment; make another one, or call `restart`, for the next.

    Args:
        model: The documented model.
    """

    def __init__(self, model: Mapping[str, Any]):
        control, trust = model["control"], model["trust"]
        self._nominal, self._residual = FormulaMap(model), FormulaResidual(model)
        self._failures = np.reshape(np.array(model["failures"], float), (-1, len(self.space.names)))
        names = ("cautious", "viability", "avoid_failures", "evaluations", "horizon", "largest_change")
        self._settings = ControlSettings(**{name: control[name] for name in names})
        self._start = Trust.start(
            self.space.state_scale,
            cast("Residual", self._residual),
            drift=model["disturbance"]["used"],
            monitor=trust["nominal"],
            reject_outliers=model["outliers"]["used"],
            warm_start=trust["warm_start"],
        )
        self.restart()

    @property
    def space(self) -> StepSpace:
        """Names, units and ranges."""
        return self._nominal.space

    def restart(self) -> None:
        """Begins a deployment: what was estimated in the one before is forgotten."""
        self._trust = self._start

    def plan(
        self,
        state: ArrayLike | None,
        target: ArrayLike,
        previous: ArrayLike | None = None,
        phase: float = np.nan,
        ahead: ArrayLike = (),
    ) -> FilterPlan:
        """Plans a step; whatever the numbers are, there is a command.

        Args:
            state: As measured at this section; shape (n,). None if there is no measurement that is recent enough.
            target: Wanted at the next section, NaN in coordinates without a target; shape (n,).
            previous: Command of the step before; shape (m,).
            phase: Phase of the robot's periodic context [rad], NaN if it is unknown or there is none.
            ahead: Targets of the steps after it; shape (k, n).

        Raises:
            ValueError: State, target or command has the wrong size.
        """
        n, m = len(self.space.state), len(self.space.command)
        state = as_vector("state", np.full(n, np.nan) if state is None else state, n)
        target, before = (
            as_vector("target", target, n),
            None if previous is None else as_vector("previous", previous, m),
        )
        later = np.reshape(np.asarray(ahead, float), (-1, n))[: self._settings.horizon - 1]
        known = before is None or bool(np.isfinite(before).all())
        usable = known and not np.isinf(target).any() and not np.isinf(later).any()
        status = UNCORRECTED if usable else StepStatus.INVALID
        if status == UNCORRECTED and np.isfinite(state).all():
            step_map = self._trust.step_map(self._nominal, cast("Residual", self._residual), phase)
            controller = CautiousController(step_map, self._nominal, self._failures, self._settings, previous=before)
            try:
                plan = controller(state, target, before, later)
                return FilterPlan(int(StepStatus.OK), plan.command, plan.predicted, plan.std)
            except StepFailed as failure:
                status = failure.status
        unknown = np.full(n, np.nan)
        return FilterPlan(int(status), self._uncorrected(target, before if known else None), unknown, unknown)

    def update(
        self, state: ArrayLike | None, command: ArrayLike, next_state: ArrayLike | None, phase: float = np.nan
    ) -> int:
        """Learns the disturbance from a step that was made; without both states it changes nothing.

        Args:
            state: As measured at the section where it started; shape (n,). None if it is unknown.
            command: As planned; shape (m,).
            next_state: As measured where it ended; shape (n,). None if it is unknown.
            phase: Phase at which it started, as for `plan`.

        Returns:
            0 if it learned; else the status of the step on the nominal map, `INVALID` where a number is not finite.
        """
        if state is None or next_state is None:
            return int(StepStatus.INVALID)
        start, end = (as_vector("state", each, len(self.space.state)) for each in (state, next_state))
        command = as_vector("command", command, len(self.space.command))
        expected, status = self._nominal.evaluate(start, command)
        if not np.isfinite(end).all() or status != StepStatus.OK:
            return int(status or StepStatus.INVALID)
        point, inputs = join_points(start, command), self.space.scaled_inputs(start, command)
        mean, std = self._residual.mean(point), self._residual.std(point, include_noise=True)
        step = PredictedStep(inputs=inputs, error=end - expected, mean=mean, std=std, phase=phase)
        self._trust = self._trust.after(cast("Residual", self._residual), step)
        return int(StepStatus.OK)

    def _uncorrected(self, target: Array, previous: Array | None) -> Array:
        """Command of the nominal map at the target as the state; else the previous one, or the middle of the bounds."""
        space, change = self.space, CommandChange(self._settings.largest_change, previous)
        start = space.command_centre if previous is None else previous
        nominal = BudgetedMap(self._nominal, EvaluationBudget(self._settings.evaluations // 2))
        try:
            goal = Targets(space, checked_target(space, target))
            held = np.where(goal.wanted, target, space.state_centre)
            return StepController(change.limited(nominal)).towards(held, goal, start).command
        except (StepFailed, ValueError):
            bounds = change.bounds(space)
            return np.clip(start, bounds.command_lower, bounds.command_upper)


@final
class FormulaMap(StepMap):
    """The nominal map of a documented model.

    Args:
        model: The model.
    """

    def __init__(self, model: Mapping[str, Any]):
        state = [replace(_quantity(each), weight=float(each["weight"])) for each in model["state"]]
        self._space = StepSpace(tuple(state), tuple(map(_quantity, model["command"])))
        self._nominal = _arrays(model["nominal"])

    @property
    def space(self) -> StepSpace:
        """Names, units and ranges."""
        return self._space

    def evaluate(self, state: ArrayLike, command: ArrayLike) -> Outcome:
        """Next states and status codes; never raises for a step that fails."""
        points, n = join_points(state, command), len(self._space.state)
        rows = points.reshape(-1, points.shape[-1])
        status = self._status(rows)
        found = nominal_state(NUMBERS, self._nominal, np.where(np.isfinite(rows), rows, 0.0))
        moved = np.where((status == StepStatus.OK)[:, None], found, np.nan)
        return Outcome(moved.reshape(*points.shape[:-1], n), status.reshape(points.shape[:-1]))

    def jacobian(self, state: ArrayLike, command: ArrayLike) -> Array:
        """∂(next state)/∂(state, command); shape (…, n, n + m). NaN where a step fails.

        Outside of the range where a polynomial was fitted, it is that of the nearest point inside, as in a run.
        """
        points, nominal = join_points(state, command), self._nominal
        affine = nominal["kind"] == "affine"
        ends = (
            (-np.inf, np.inf)
            if affine
            else (nominal["centre"] - nominal["scale"], nominal["centre"] + nominal["scale"])
        )
        found = _derivatives(lambda rows: nominal_state(NUMBERS, nominal, rows), np.clip(points, *ends))
        failed = (self._status(points.reshape(-1, points.shape[-1])) != StepStatus.OK).reshape(points.shape[:-1])
        return np.where(failed[..., None, None], np.nan, found)

    def _status(self, rows: Array) -> Codes:
        """Status codes (B,): of the nearest samples if most of them failed, or that the point is not finite."""
        status = np.where(np.isfinite(rows).all(axis=1), int(StepStatus.OK), int(StepStatus.INVALID))
        if self._nominal["kind"] != "affine" and len(self._nominal["samples"]["status"]):
            neighbours, samples = int(self._nominal["neighbours"]), self._nominal["samples"]
            known = np.flatnonzero(status == StepStatus.OK)
            squared = NUMBERS.squared_distances(scaled_point(NUMBERS, self._nominal, rows[known]), samples["points"])
            near = samples["status"][np.argsort(squared, axis=1, kind="stable")[:, :neighbours]].astype(int)
            failed = np.count_nonzero(near, axis=1) > neighbours // 2
            status[known] = np.where(failed, near.max(axis=1), int(StepStatus.OK))
        return status


@final
class FormulaResidual:
    """The residual of a documented model, with what `CorrectedMap` and `Trust` use of a `Residual`.

    Args:
        model: The model.
    """

    def __init__(self, model: Mapping[str, Any]):
        self.kind = str(model["residual"]["kind"])
        self.sizes = len(model["state"]), len(model["command"])
        self.is_known = bool(model["trust"]["judges"])
        self._parts = [_with_inverses(_arrays(each)) for each in model["residual"]["regressions"]]
        self.noise_std = np.array([float(each["noise_std"]) for each in self._parts])

    def mean(self, points: Array) -> Array:
        """Expected residual; (…, n + m) to (…, n) [units of the state]."""
        return self._of_rows(0, points.reshape(-1, points.shape[-1])).reshape(*points.shape[:-1], self.sizes[0])

    def std(self, points: Array, *, include_noise: bool = False) -> Array:
        """Its standard deviation, with or without the noise of a step; (…, n + m) to (…, n) [units of the state]."""
        std = self._of_rows(1, points.reshape(-1, points.shape[-1])).reshape(*points.shape[:-1], self.sizes[0])
        return np.hypot(std, self.noise_std) if include_noise else std

    def mean_gradient(self, points: Array) -> Array:
        """∂mean/∂(state, command); (…, n + m) to (…, n, n + m)."""
        return _derivatives(lambda rows: self._of_rows(0, rows), points)

    def std_gradient(self, points: Array) -> Array:
        """∂std/∂(state, command), zero where there is no deviation; (…, n + m) to (…, n, n + m)."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.nan_to_num(_derivatives(lambda rows: self._of_rows(1, rows), points))

    def _of_rows(self, which: int, rows: Any) -> Any:
        return np.concatenate([regression(NUMBERS, part, rows)[which] for part in self._parts], axis=1)


@final
@dataclass(frozen=True)
class ZeroResidual:
    """No residual, for the map that plans while the learned one is not trusted.

    Attributes:
        sizes: n and m.
    """

    sizes: tuple[int, int]

    @property
    def noise_std(self) -> Array:
        """Zero; shape (n,)."""
        return np.zeros(self.sizes[0])

    def mean(self, points: Array) -> Array:
        """Zero; shape (…, n)."""
        return np.zeros((*points.shape[:-1], self.sizes[0]))

    std = mean

    def mean_gradient(self, points: Array) -> Array:
        """Zero; shape (…, n, n + m)."""
        return np.zeros((*points.shape[:-1], self.sizes[0], sum(self.sizes)))

    std_gradient = mean_gradient


def zero_residual(state_size: int, command_size: int) -> ZeroResidual:
    """No residual."""
    return ZeroResidual((state_size, command_size))


@final
class Numbers:
    """The `Algebra` of NumPy's arrays; also of complex ones, with which formulas are differentiated."""

    def constant(self, numbers: ArrayLike) -> Any:
        """A number, a row (d,) or a matrix."""
        return np.asarray(numbers)

    def exp(self, x: Any) -> Any:
        """Exponential, number by number."""
        return np.exp(x)

    def sqrt(self, x: Any) -> Any:
        """Square root, number by number."""
        return np.sqrt(x)

    def clipped(self, x: Any, lower: float, upper: float) -> Any:
        """The nearest numbers within limits."""
        return np.where(np.real(x) < lower, lower, np.where(np.real(x) > upper, upper, x))

    def joined(self, parts: Sequence[Any]) -> Any:
        """Rows side by side."""
        return np.concatenate(parts, axis=1)

    def chosen(self, x: Any, columns: NDArray[np.int64]) -> Any:
        """Columns of rows."""
        return x[:, columns]

    def sum_of_squares(self, x: Any) -> Any:
        """Sum of the squares of each row; (B, 1)."""
        return np.sum(x * x, axis=1, keepdims=True)

    def squared_distances(self, x: Any, centres: NDArray[np.float64]) -> Any:
        """Squared distances to centres (k, d); (B, k)."""
        return np.sum((x[:, None] - centres) ** 2, axis=2)


NUMBERS: Final = Numbers()
"""The algebra of the formulas here."""


def solved_square(matrix: Array, right: Array) -> tuple[None, None, Array, bool]:
    """The solution of a square system, and whether there is none, as LAPACK's gesv returns it."""
    try:
        return None, None, np.asarray(np.linalg.solve(matrix, right), float), False
    except np.linalg.LinAlgError:
        return None, None, right, True


def _derivatives(function: Any, points: Array) -> Array:
    """Derivatives of a function from rows (B, d) to rows (B, n), at points (…, d); shape (…, n, d)."""
    size = points.shape[-1]
    moved = points[..., None, :] + TINY * 1j * np.eye(size)
    found = function(moved.reshape(-1, size)).imag / TINY
    return np.swapaxes(found.reshape(*points.shape[:-1], size, -1), -1, -2)


def _arrays(part: Any) -> Any:
    """The part of a model with its lists as arrays."""
    if isinstance(part, Mapping):
        return {key: _arrays(value) for key, value in part.items() if key != "data"}
    return np.array(part) if isinstance(part, list) else part


def _with_inverses(part: Mapping[str, Any]) -> dict[str, Any]:
    """A regression with the inverses of its factors, which are needed at every point."""
    factors = [key for key in part if key.endswith("_factor")]
    return {**part, **{INVERSE + key: np.linalg.inv(part[key]) for key in factors}}


def _quantity(saved: Mapping[str, Any]) -> Quantity:
    return Quantity(saved["name"], saved["unit"], float(saved["lower"]), float(saved["upper"]))

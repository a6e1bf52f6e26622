"""The learned controller as a filter on a robot: (target, latest state) to the command of the next step.

A `StepFilter` is made from the documented model alone (docs/model_file.md): its maps are the formulas of that file, its
commands those of a run, by the same code. `stepgap export --to python` writes it, with all that it needs and the model,
as one file for NumPy (`python_source`).
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Final, NamedTuple, cast, final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stepgap.control.cautious_controller import CautiousController, CautiousPlan
from stepgap.control.following import Following
from stepgap.control.goal import Targets
from stepgap.control.settings import ControlSettings
from stepgap.control.shortfall import Shortfall
from stepgap.control.step_controller import StepController, as_vector, checked_target
from stepgap.control.wrapped_map import BudgetedMap, CommandChange, EvaluationBudget
from stepgap.export.controller.formulas import INVERSE, nominal_state, regression, scaled_point
from stepgap.learning.beliefs_data import beliefs_from_dict
from stepgap.learning.believed import believed_after, planning_map
from stepgap.learning.residual import HistoryInputs, Residual, join_points
from stepgap.step import Array, Codes, Outcome, Quantity, StepFailed, StepMap, StepRecord, StepSpace, StepStatus

UNCORRECTED: Final = 9  # no `StepStatus` has this number
"""Status of a plan without a usable measurement: its command is that of the nominal map if the target is held."""

TINY: Final = 1e-100  # Imaginary part of an input with which a formula is differentiated: no digit is lost


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
        control = model["control"]
        beliefs = model["beliefs"]
        self._nominal = FormulaMap(model)
        self._residual = FormulaResidual(model)
        self._failures = np.reshape(np.array(model["failures"], float), (-1, len(self.space.names)))
        names = ("cautious", "viability", "avoid_failures", "evaluations", "horizon", "largest_change")
        self._settings = ControlSettings(**{name: control[name] for name in names})
        self._beliefs = None if beliefs is None else beliefs_from_dict(beliefs, self._residual.sizes)
        farthest = None if control["farthest"] is None else np.array(control["farthest"])
        surprise = np.inf if control["surprise"] is None else control["surprise"]
        self._start = Following(Shortfall.start(self.space), control["make_up"], surprise, farthest)
        self.forget_way()

    @property
    def space(self) -> StepSpace:
        """Names, units and ranges."""
        return self._nominal.space

    @property
    def alarm(self) -> str | None:
        """What the latest step showed: that the robot has `changed`, or is again as `earlier`; None for neither."""
        return None if self._beliefs is None else self._beliefs.alarm

    def restart(self) -> None:
        """Begins another deployment with what was learned; the robot may have changed meanwhile."""
        self.forget_way()
        if self._beliefs is not None:
            self._beliefs = self._beliefs.redeployed()

    def forget_way(self) -> None:
        """How the robot followed so far no longer counts, as where something else has moved it meanwhile."""
        self._following = self._start
        self._target = self._predicted = np.full(len(self.space.state), np.nan)

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
        n = len(self.space.state)
        m = len(self.space.command)
        state = as_vector("state", np.full(n, np.nan) if state is None else state, n)
        target = as_vector("target", target, n)
        before = None if previous is None else as_vector("previous", previous, m)
        later = np.reshape(np.asarray(ahead, float), (-1, n))[: self._settings.horizon - 1]
        finite = before is None or bool(np.isfinite(before).all())
        usable = finite and not np.isinf(target).any() and not np.isinf(later).any()
        measured = bool(np.isfinite(state).all())
        around = self._following.around(state) if measured else None
        status = UNCORRECTED if usable else StepStatus.INVALID
        plan = None
        if usable and measured:
            residual = cast("Residual", self._residual)
            beliefs = self._beliefs
            if beliefs is not None and before is not None and self.space.is_lagged:
                beliefs = beliefs.with_command_before(self.space.point_of(before))
            step_map = planning_map(self._nominal, residual, beliefs, phase, np.zeros(0))
            controller = CautiousController(
                step_map, self._nominal, self._failures, self._settings, previous=before, around=around
            )
            try:
                plan = self._planned(controller, state, np.array([target, *later]))
                status = StepStatus.OK
            except StepFailed as failure:
                status = failure.status
        if plan is None:
            unknown = np.full(n, np.nan)
            plan = CautiousPlan(self._uncorrected(target, before if finite else None, around), unknown, unknown)
        self._target, self._predicted = target, plan.predicted
        return FilterPlan(int(status), plan.command, plan.predicted, plan.std)

    def _planned(self, controller: CautiousController, state: Array, targets: Array) -> CautiousPlan:
        """The plan for targets (1 + k, n); raises StepFailed."""
        target, *later = self._following.wanted(targets)
        told = self._following.told(state, target)
        if told is None:
            return controller(state, target, controller.previous, later)
        return CautiousPlan(told, controller.step_map(state, told), controller.step_std(state, told))

    def update(
        self,
        state: ArrayLike | None,
        command: ArrayLike,
        next_state: ArrayLike | None,
        phase: float = np.nan,
        pose: ArrayLike = (np.nan, np.nan, np.nan),
        part: float = 1.0,
        *,
        learns: bool = True,
    ) -> int:
        """Learns from a step that was made, and how it followed the latest plan.

        Without both states, nothing is known of the step before the next one.

        Args:
            state: As measured at the section where it started; shape (n,). None if it is unknown.
            command: As planned; shape (m,).
            next_state: As measured where it ended; shape (n,). None if it is unknown.
            phase: Phase at which it started, as for `plan`.
            pose: Place [m] and heading [rad] where it ended, from any zero, NaN where not measured; shape (3,).
            part: Part of its duration after which another plan ended it.
            learns: Whether beliefs change.

        Returns:
            0 if it learned; else the status of the step on the nominal map, `INVALID` where a number is not finite.
        """
        unknown = np.full(len(self.space.state), np.nan)
        start, end = (
            as_vector("state", unknown if values is None else values, len(unknown)) for values in (state, next_state)
        )
        command = as_vector("command", command, len(self.space.command))
        predicted = self._predicted if np.isfinite(start).all() else unknown
        pose = as_vector("pose", pose, len(StepSpace.pose_names))
        self._following = self._following.after(self._target, predicted, end, pose, part)
        self._target = self._predicted = unknown
        record = StepRecord(start, command, command, end, StepStatus.OK)
        expected, status = self._nominal.evaluate(start, command)
        if self._beliefs is not None and learns:
            residual = cast("Residual", self._residual)
            error = end - expected
            self._beliefs, learned = believed_after(self._beliefs, self._nominal, residual, record, error, phase)
        else:
            learned = bool(np.isfinite(end).all())
        return int(StepStatus.OK if learned else status or StepStatus.INVALID)

    def _uncorrected(self, target: Array, previous: Array | None, around: tuple[Array, Array] | None) -> Array:
        """Command of the nominal map at the target as the state; else the previous one, or the middle of the bounds."""
        space = self.space
        change = CommandChange(self._settings.largest_change, previous, around)
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
        state = [replace(_quantity(quantity), weight=float(quantity["weight"])) for quantity in model["state"]]
        command = tuple(map(_quantity, model["command"]))
        seconds = float(model.get("planar_seconds", 0.0))
        self._space = StepSpace(tuple(state), command, is_lagged=bool(model.get("lagged")), planar_seconds=seconds)
        self._nominal = _arrays(model["nominal"])

    @property
    def space(self) -> StepSpace:
        """Names, units and ranges."""
        return self._space

    def evaluate(self, state: ArrayLike, command: ArrayLike) -> Outcome:
        """Next states and status codes; never raises for a step that fails."""
        points = join_points(state, command)
        n = len(self._space.state)
        rows = points.reshape(-1, points.shape[-1])
        status = self._status(rows)
        ends = nominal_state(NUMBERS, self._nominal, np.where(np.isfinite(rows), rows, 0.0))
        moved = np.where((status == StepStatus.OK)[:, None], ends, np.nan)
        return Outcome(moved.reshape(*points.shape[:-1], n), status.reshape(points.shape[:-1]))

    def jacobian(self, state: ArrayLike, command: ArrayLike) -> Array:
        """∂(next state)/∂(state, command); shape (…, n, n + m). NaN where a step fails.

        Outside of the range where a polynomial was fitted, it is that of the nearest point inside, as in a run.
        """
        points = join_points(state, command)
        nominal = self._nominal
        affine = nominal["kind"] == "affine"
        ends = (
            (-np.inf, np.inf)
            if affine
            else (nominal["centre"] - nominal["scale"], nominal["centre"] + nominal["scale"])
        )
        derivatives = _derivatives(lambda rows: nominal_state(NUMBERS, nominal, rows), np.clip(points, *ends))
        failed = (self._status(points.reshape(-1, points.shape[-1])) != StepStatus.OK).reshape(points.shape[:-1])
        return np.where(failed[..., None, None], np.nan, derivatives)

    def _status(self, rows: Array) -> Codes:
        """Status codes (B,): of the nearest samples if most of them failed, or that the point is not finite."""
        status = np.where(np.isfinite(rows).all(axis=1), int(StepStatus.OK), int(StepStatus.INVALID))
        if self._nominal["kind"] != "affine" and len(self._nominal["samples"]["status"]):
            neighbours = int(self._nominal["neighbours"])
            samples = self._nominal["samples"]
            finite = np.flatnonzero(status == StepStatus.OK)
            squared = NUMBERS.squared_distances(scaled_point(NUMBERS, self._nominal, rows[finite]), samples["points"])
            near = samples["status"][np.argsort(squared, axis=1, kind="stable")[:, :neighbours]].astype(int)
            failed = np.count_nonzero(near, axis=1) > neighbours // 2
            status[finite] = np.where(failed, near.max(axis=1), int(StepStatus.OK))
        return status


@final
class FormulaResidual:
    """The fitted residual of a documented model, with what `CorrectedMap` and beliefs use of a `Residual`.

    Args:
        model: The model.
    """

    def __init__(self, model: Mapping[str, Any]):
        self.kind = str(model["residual"]["kind"])
        self.sizes = len(model["state"]), len(model["command"])
        self.history_inputs = HistoryInputs()
        self.regressions = [FormulaRegression(part) for part in model["residual"]["regressions"]]
        self.noise_std = np.array([regression.noise_std for regression in self.regressions])

    def conditioned_on(self, history: Array) -> "FormulaResidual":
        """The residual, which depends on state and command alone."""
        del history
        return self

    def mean(self, points: Array) -> Array:
        """Expected residual; (…, n + m) to (…, n) [units of the state]."""
        return np.stack([regression.mean(points) for regression in self.regressions], axis=-1)

    def std(self, points: Array) -> Array:
        """Its standard deviation, without the noise of a step; (…, n + m) to (…, n) [units of the state]."""
        return np.stack([regression.std(points) for regression in self.regressions], axis=-1)

    def mean_gradient(self, points: Array) -> Array:
        """∂mean/∂(state, command); (…, n + m) to (…, n, n + m)."""
        return np.stack([regression.mean_gradient(points) for regression in self.regressions], axis=-2)

    def std_gradient(self, points: Array) -> Array:
        """∂std/∂(state, command), zero where there is no deviation; (…, n + m) to (…, n, n + m)."""
        return np.stack([regression.std_gradient(points) for regression in self.regressions], axis=-2)


@final
class FormulaRegression:
    """A regression of a documented model, with what others use of a `Regression`.

    Args:
        part: The regression in the model.
    """

    def __init__(self, part: Mapping[str, Any]):
        arrays = _arrays(part)
        # The inverses of the factors are needed at every point.
        inverses = {INVERSE + key: np.linalg.inv(arrays[key]) for key in arrays if key.endswith("_factor")}
        self._part = {**arrays, **inverses}
        self.noise_std = float(part["noise_std"])

    def mean(self, point: Array) -> Array:
        """Expected value; (…, d) to (…)."""
        return self._of_rows(0, point.reshape(-1, point.shape[-1])).reshape(point.shape[:-1])

    def std(self, point: Array) -> Array:
        """Its standard deviation; (…, d) to (…)."""
        return self._of_rows(1, point.reshape(-1, point.shape[-1])).reshape(point.shape[:-1])

    def mean_gradient(self, point: Array) -> Array:
        """∂mean/∂point; shape (…, d)."""
        return _derivatives(lambda rows: self._of_rows(0, rows), point)[..., 0, :]

    def std_gradient(self, point: Array) -> Array:
        """∂std/∂point, zero where there is no deviation; shape (…, d)."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.nan_to_num(_derivatives(lambda rows: self._of_rows(1, rows), point)[..., 0, :])

    def _of_rows(self, which: int, rows: Any) -> Any:
        return regression(NUMBERS, self._part, rows)[which]


@final
class Numbers:
    """The `Algebra` of NumPy's arrays; also of complex ones, with which formulas are differentiated."""

    def constant(self, numbers: ArrayLike) -> Any:
        """A number, a row (d,) or a matrix."""
        return np.asarray(numbers)

    def exp(self, x: Any) -> Any:
        """Exponential, number by number."""
        return np.exp(x)

    def cos(self, x: Any) -> Any:
        """Cosine, number by number."""
        return np.cos(x)

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


NUMBERS: Final = Numbers()  # The algebra of the formulas here


def uncompiled(function: Any) -> Any:
    """The function, which NumPy executes: there is no compiler here."""
    return function


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
    imaginary = function(moved.reshape(-1, size)).imag / TINY
    return np.swapaxes(imaginary.reshape(*points.shape[:-1], size, -1), -1, -2)


def _arrays(part: Any) -> Any:
    """The part of a model with its lists as arrays."""
    if isinstance(part, Mapping):
        return {key: _arrays(value) for key, value in part.items() if key != "data"}
    return np.array(part) if isinstance(part, list) else part


def _quantity(saved: Mapping[str, Any]) -> Quantity:
    return Quantity(saved["name"], saved["unit"], float(saved["lower"]), float(saved["upper"]))

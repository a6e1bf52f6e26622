"""The controller that a run learned, in a portable form: a closed set of maps and regressions that have formulas.

- The nominal map is an `AffineMap` or a `SurrogateMap`. Any other one, such as integrated equations of motion, is
  replaced by a surrogate that is fitted to it.
- The regressions of the residual are `Zero`, `Polynomial`, `Posterior`, or `GaussianProcessRegression` with a
  `SparseGaussianProcess`. An exact process of many steps is approximated by inducing points, since its Cholesky factor
  would have as many numbers as half the square of its steps.
- The beliefs are those of a run, and go on learning as in a run.

What is replaced is compared with the original, and a sentence reports the differences. The map of a
`PortableController` is again a `CorrectedMap`, so `CautiousController` computes the commands that an exported
controller has to compute.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import nan
from typing import Any, final

import numpy as np

from stepgap.base.errors import InputError
from stepgap.control.cautious_controller import CautiousController
from stepgap.control.following import Following
from stepgap.control.settings import ControlSettings
from stepgap.experiment.run import Run
from stepgap.export.controller.passport import passport_of
from stepgap.gauss.gaussian_process import GaussianProcess, SparseGaussianProcess, condition_sparse
from stepgap.gauss.gaussian_process_fit import spread_points
from stepgap.learning.beliefs import Beliefs
from stepgap.learning.believed import believed, believed_after, planning_map
from stepgap.learning.corrected_map import CorrectedMap
from stepgap.learning.gaussian_process_regression import GaussianProcessRegression
from stepgap.learning.learner import Learner
from stepgap.learning.observations import Observations, error_of, no_observations, observe
from stepgap.learning.polynomial import Polynomial
from stepgap.learning.posterior import Posterior
from stepgap.learning.regression import Regression
from stepgap.learning.residual import HistoryInputs, Residual, join_points
from stepgap.learning.zero import Zero
from stepgap.robots.nominal_maps.affine_map import AffineMap
from stepgap.robots.nominal_maps.surrogate_map import WIDENED, Samples, SurrogateMap, fit_surrogate
from stepgap.step import Array, StepMap, StepRecord, StepSpace, StepStatus

SURROGATE_ERROR = 1e-5
"""Error of the surrogate of a nominal map in half ranges of the state below which no further samples are taken."""

EXPORTED_SIZES = (10, 20, 30, 40, 50, 60)
"""Numbers of inducing points that are tried, in turn; with 60 and four inputs, a regression has 4,400 numbers."""

SMALL_LOSS = 0.05
"""No more inducing points are taken once mean and standard deviation differ by less than this from those of the exact
process, in standard deviations of a step's noise."""

COMPARISON_POINTS = 1000  # Number of random points at which a replacement is compared with the original

SAMPLE_RESOLUTION = 2.0**-15
"""Unit in which the sampled points of a surrogate are stored, in half ranges: they only locate the steps that fail."""


@final
@dataclass(frozen=True, eq=False)
class PortableController:
    """The controller before the first step of a deployment, of parts that have formulas.

    Attributes:
        nominal: The nominal map, an `AffineMap` or a `SurrogateMap`.
        residual: The fitted residual, a function of state and command.
        beliefs: What is believed of its remaining error; None if nothing is learned during a deployment.
        failures: Points (state, command) of steps that failed; shape (k, n + m).
        settings: Settings of step control, without a table; `surprise` is that of this deployment, and `farthest` says
            what follows from `widening`.
        farthest: As of `Following`.
        steps: The steps that the beliefs were learned from, for a comparison of robots; none for a fitted residual,
            which has its own.
        approximations: Sentences on what was replaced, and by how much it differs.
        notes: Sentences on what the portable form does not do.
        passport: Which robot it is, and what it was learned from; see `passport_of`. Empty if that is not known.
    """

    nominal: StepMap
    residual: Residual
    beliefs: Beliefs | None
    failures: Array
    settings: ControlSettings
    farthest: Array | None = None
    steps: Observations | None = None
    approximations: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    passport: Mapping[str, Any] = field(default_factory=dict)

    @property
    def space(self) -> StepSpace:
        """Names, units and ranges."""
        return self.nominal.space

    @cached_property
    def map(self) -> CorrectedMap:
        """The map that plans the first step of a deployment if its phase is unknown."""
        return self.map_by(self.beliefs)

    @cached_property
    def learned(self) -> Residual:
        """The error as far as it is known, with the steps from which it was learned."""
        if self.beliefs is None or self.residual.kind != "none":
            return self.residual
        steps = no_observations(self.space) if self.steps is None else self.steps
        return believed(self.residual, self.beliefs.features, self.beliefs.mixture(nan), steps)

    @cached_property
    def controller(self) -> CautiousController:
        """The controller of the first step if its phase is unknown."""
        return CautiousController(self.map, self.nominal, self.failures, self.settings)

    def map_by(self, beliefs: Beliefs | None, phase: float = nan) -> CorrectedMap:
        """Returns the map that plans a step which starts at a phase [rad], NaN if it is unknown."""
        return planning_map(self.nominal, self.residual, beliefs, phase, np.zeros(0))

    def after(self, beliefs: Beliefs | None, record: StepRecord, phase: float) -> Beliefs | None:
        """Returns what is believed after a step, as an exported controller computes it.

        Args:
            beliefs: What was believed before.
            record: The step.
            phase: Phase at which it started [rad], NaN if it is unknown.
        """
        if beliefs is None:
            return None
        error = error_of(record, self.nominal)
        return believed_after(beliefs, self.nominal, self.residual, record, error, phase)[0]


def portable_controller(
    run: Run, deployment: int | None, rng: np.random.Generator, name: str = ""
) -> PortableController:
    """Brings the controller at the start of a deployment into portable form.

    Args:
        run: The recorded run.
        deployment: Number of the deployment; None for the one after the last.
        rng: Draws the points at which maps are sampled and compared.
        name: Name of the robot in its passport.

    Raises:
        InputError: There is no such deployment, or its controller has no portable form.
    """
    learner = run.learner(deployment)
    control = run.needed(run.settings).control
    return portable_form(learner, control, rng, passport_of(run, deployment, name), str(run.folder))


def portable_form(
    learner: Learner, control: ControlSettings, rng: np.random.Generator, passport: Mapping[str, Any], source: str
) -> PortableController:
    """Brings the controller of a learner into portable form.

    Args:
        learner: Before the first step of a deployment.
        control: How commands are planned.
        rng: Draws the points at which maps are sampled and compared.
        passport: Of the robot.
        source: What it was learned from, for messages.

    Raises:
        InputError: It has no portable form.
    """
    space = learner.nominal.space
    residual = learner.residual
    beliefs = learner.beliefs
    if space.adds_up.any():
        raise InputError(f"{source}: its targets are distances that add up, which no exported controller follows")
    _check_inputs(learner)
    noise = learner.step_map().noise_std / space.state_scale
    nominal, replaced = _portable_nominal(learner.nominal, noise, rng)
    points = _random_points(space, rng)
    replacements = [
        _portable_regression(regression, name, scale, points)
        for regression, name, scale in zip(residual.regressions, space.state_names, space.state_scale, strict=True)
    ]
    following = Following.start(space, control, learner.farthest if space.planar_seconds else None)
    own_steps = beliefs is not None and residual.kind == "none"
    return PortableController(
        nominal,
        replace(residual, regressions=tuple(regression for regression, _ in replacements)),
        beliefs,
        learner.failures,
        replace(control, table=0, surprise=following.surprise),
        following.farthest,
        observe(learner.known.planned(), learner.nominal) if own_steps else None,
        approximations=(*replaced, *(loss for _, loss in replacements if loss)),
        notes=_notes(space, control, learner),
        passport=passport,
    )


def _check_inputs(learner: Learner) -> None:
    """Raises InputError if what is learned depends on more than state, command and the step before."""
    by_touchdown = learner.beliefs is not None and learner.nominal.space.context_inputs
    if by_touchdown or learner.residual.history_inputs != HistoryInputs():
        raise InputError(
            f"residual '{learner.residual.kind}': inputs that a touchdown finds and a forgetting time cannot be "
            "exported; run with learning.forgetting_time = inf and, on uneven ground, ground.inputs = false"
        )


def _notes(space: StepSpace, control: ControlSettings, learner: Learner) -> tuple[str, ...]:
    notes = [
        f"{quantity.name} is that above the {quantity.above} of the step: subtract what your robot finds, and plan at "
        "touchdown"
        for quantity in space.state
        if quantity.above
    ]
    if not space.tracked.all():
        untracked = ", ".join(quantity.name for quantity in space.state if not quantity.weight)
        notes.append(
            f"{untracked}: the errors of the planned steps count alone in C and FMU; a run and Python, where states "
            "are not tracked, count those of all later steps, too"
        )
    if space.is_lagged:
        notes.append(
            "it plans for what a command does to the step after it, so pass the command of the step before; C and FMU "
            "then plan for one target, which needs all coordinates"
        )
    if control.horizon > 1:
        notes.append(
            "control.horizon: with one target, each command is chosen for its own step; C has ..._plan_ahead, and "
            "Python the argument ahead"
        )
    if control.make_up and space.planar_seconds:
        notes.append("control.make_up: the FMU has no input for a pose; it keeps the sum of the velocities")
    if control.table:
        notes.append("control.table: the commands are solved for, not taken from a table")
    if learner.settings.online and learner.beliefs is None and learner.settings.residual != "none":
        notes.append("learning.online: the residual is that of the start of the deployment; it learns no further step")
    return tuple(notes)


def _random_points(space: StepSpace, rng: np.random.Generator) -> Array:
    """Random states of the sampled range of a surrogate, and commands within their bounds; shape (k, n + m)."""
    unit = rng.uniform(-1, 1, (COMPARISON_POINTS, len(space.names)))
    n = len(space.state)
    return join_points(space.state_centre + WIDENED * space.state_scale * unit[:, :n], space.command_at(unit[:, n:]))


def _portable_nominal(
    nominal: StepMap, noise: Array, rng: np.random.Generator
) -> tuple[AffineMap | SurrogateMap, tuple[str, ...]]:
    """The nominal map, or a surrogate of it and by how much that differs."""
    if isinstance(nominal, AffineMap):
        return nominal, ()
    if isinstance(nominal, SurrogateMap):
        return _with_small_samples(nominal), ()
    surrogate = _with_small_samples(fit_surrogate(nominal, rng, good_enough=SURROGATE_ERROR))
    points = _random_points(nominal.space, rng)
    n = len(nominal.space.state)
    expected, replaced = (step_map.evaluate(points[:, :n], points[:, n:]) for step_map in (nominal, surrogate))
    both = (expected.status == StepStatus.OK) & (replaced.status == StepStatus.OK)
    error = (replaced.next_state - expected.next_state)[both] / nominal.space.state_scale
    wrong = np.mean((expected.status == StepStatus.OK) != (replaced.status == StepStatus.OK))
    replacement = (
        f"polynomial of degree {surrogate.degree}, which misjudges whether a step fails at {wrong:.2%} of points"
    )
    return surrogate, (_approximation("nominal map", replacement, nominal.space.state_names, error, noise),)


def _with_small_samples(surrogate: SurrogateMap) -> SurrogateMap:
    """The surrogate with sampled points that need 16 bits, or with none if no step failed, as they say nothing then."""
    points, next_state, status = surrogate.samples
    if (status == StepStatus.OK).all():
        return replace(surrogate, samples=Samples(points[:0], next_state[:0], status[:0]))
    rounded = np.clip(np.round(points / SAMPLE_RESOLUTION), -(2**15), 2**15 - 1) * SAMPLE_RESOLUTION
    return replace(surrogate, samples=Samples(rounded, next_state, status))


def _approximation(subject: str, replacement: str, names: tuple[str, ...], error: Array, noise: Array) -> str:
    """What was replaced, and by how much its results differ at random points of the range.

    Args:
        subject: What was replaced.
        replacement: By what.
        names: Names of the state coordinates that it concerns.
        error: Differences (k, names) [half ranges].
        noise: Standard deviation of a step's noise [half ranges], 0 if it is unknown; one for each name.
    """
    size = np.abs(error) if len(error) else np.full((1, len(names)), np.nan)
    parts = list[str]()
    for name, sizes, std in zip(names, size.T, noise, strict=True):
        rms = np.sqrt(np.mean(sizes**2))
        worst = sizes.max()
        beside = f" ({worst / std:.1g} of the noise of a step)" if std > 0 else ""
        parts.append(f"{name}: {rms:.1g} of a half range, at most {worst:.1g}{beside}")
    return f"{subject} → {replacement}; root-mean-square difference of {'; '.join(parts)}"


def _portable_regression(regression: Regression, name: str, scale: float, points: Array) -> tuple[Regression, str]:
    """The regression of a state coordinate, or its approximation and by how much that differs at points (k, d)."""
    if isinstance(regression, Zero | Polynomial | Posterior):
        return regression, ""
    if not isinstance(regression, GaussianProcessRegression):
        raise InputError(
            f"residual of {name}: a {type(regression).__name__} cannot be exported; run with learning.residual = "
            '"posterior", "none", "constant", "linear", "quadratic", "gp", "gp_on_linear" or "fitrgp"'
        )
    process = regression.process
    noise = regression.noise_std
    if noise == 0:
        raise InputError(f"residual of {name}: a Gaussian process without noise cannot be exported; record more steps")
    if isinstance(process, SparseGaussianProcess) and len(process.inducing) <= EXPORTED_SIZES[-1]:
        return regression, ""
    sparse, error = _smallest_sparse(regression, np.vstack([points, regression.points]))
    centres = len(sparse.inducing)
    replacement = f"sparse Gaussian process, {centres} instead of {len(regression.values)} points"
    relative_noise = np.array([noise / scale])
    loss = _approximation(f"residual of {name}", replacement, (name,), error[:, None] / scale, relative_noise)
    return GaussianProcessRegression(sparse, regression.plug_in), loss


def _smallest_sparse(regression: GaussianProcessRegression, points: Array) -> tuple[SparseGaussianProcess, Array]:
    """The process with the fewest inducing points that suffice, and its differences at points (k, d)."""
    expected = np.stack([regression.mean(points), regression.std(points)])

    def compared(count: int) -> tuple[SparseGaussianProcess, Array]:
        sparse = _sparse(regression.process, count)
        approximated = GaussianProcessRegression(sparse, regression.plug_in)
        return sparse, np.abs(np.stack([approximated.mean(points), approximated.std(points)]) - expected).max(axis=0)

    most = min(EXPORTED_SIZES[-1], len(regression.values))
    for count in (size for size in EXPORTED_SIZES if size < most):
        sparse, error = compared(count)
        if error.max() <= SMALL_LOSS * regression.noise_std:
            return sparse, error
    return compared(most)


def _sparse(process: GaussianProcess, count: int) -> SparseGaussianProcess:
    data = process.points, process.values, process.input_scale, process.hyper_parameters
    inducing = spread_points(process.points, process.input_scale, process.hyper_parameters, count, process.kernel)
    return condition_sparse(*data, inducing, process.kernel)

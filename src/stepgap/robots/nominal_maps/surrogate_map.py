"""A surrogate of a slow or rough map: a smooth polynomial fitted to its steps (a response surface).

The steps are sampled all over the ranges and along motions (`motions.py`), and the next states fitted by least squares
in products of Legendre polynomials up to a total degree (Santner, Williams & Notz, *The Design and Analysis of Computer
Experiments*). The degree is the one with the smallest leave-one-out error, which needs neither further samples nor
further fits. The number of samples is doubled until this error hardly decreases. A simulator with contacts is not
smooth on a small scale; the polynomial is its average there, and the leave-one-out error contains the rest.

A step that leaves the sampled range ends a motion: it counts less in the fit, the further away it leads, and is not in
the error. In a walker, and in a hopper with six states, this made the error along motions smaller.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, cached_property
from itertools import combinations_with_replacement
from typing import Any, final

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import ArrayLike
from scipy.spatial import KDTree

from stepgap.base.errors import StepGapError
from stepgap.gauss.linear_regression import fit_linear
from stepgap.learning.residual import join_points
from stepgap.robots.nominal_maps.motions import WIDENED, MapFunction, Motions, Samples
from stepgap.step import Array, Codes, Outcome, StepMap, StepSpace, StepStatus

FIRST_SAMPLES = 128
MOST_SAMPLES = 2048
"""Smallest and largest number of samples; powers of two, for which a Sobol sequence is balanced."""

DEGREES = (1, 2, 3, 4, 5)  # Total degrees that are tried
WORTHWHILE = 0.85  # The samples are doubled again if that made the error at most this part of the one before

GOOD_ENOUGH = 1e-3
"""Error in half ranges of the state below which no further samples are taken, unless another one is given."""

NEIGHBOURS = 3
"""Number of nearest sampled steps; a step fails if most of these failed (classification by nearest neighbours)."""

MISJUDGED = 0.05
"""Samples are added as long as a larger part of them would be judged wrongly by their neighbours."""


@final
@dataclass(frozen=True, eq=False, repr=False)
class SurrogateMap(StepMap):
    """A polynomial of state and command, continued linearly outside the sampled range; made by `fit_surrogate`.

    Attributes:
        quantities: Names, units and ranges.
        centre: Middle of the sampled range of states and commands; shape (d,), d = n + m.
        scale: Half that range; shape (d,).
        degree: Largest total degree.
        weights: Of the products of Legendre polynomials; shape (terms, n).
        error: Leave-one-out root-mean-square error of steps that stay in the sampled range; shape (n,) [state units].
        samples: The steps that it was fitted to; where most neighbours of a point failed, so does the step.
    """

    quantities: StepSpace
    centre: Array
    scale: Array
    degree: int
    weights: Array
    error: Array
    samples: Samples

    @property
    def space(self) -> StepSpace:
        """Names, units and ranges."""
        return self.quantities

    def evaluate(self, state: ArrayLike, command: ArrayLike) -> Outcome:
        """Next states and status codes; never raises for a step that fails."""
        points = self._scaled(state, command)
        status = self._status(points)
        inside = np.clip(points, -1, 1)
        next_state = products(inside, self.degree) @ self.weights
        if (points != inside).any():  # the Jacobian takes longer than all the rest
            next_state = next_state + (self._scaled_jacobian(inside) @ (points - inside)[..., None])[..., 0]
        return Outcome(np.where((status == StepStatus.OK)[..., None], next_state, np.nan), status)

    def jacobian(self, state: ArrayLike, command: ArrayLike) -> Array:
        """∂(next state)/∂(state, command); shape (…, n, n + m). NaN where a step fails.

        Outside the sampled range this is the Jacobian at its edge, without the small effect of how it varies along it.
        """
        points = self._scaled(state, command)
        failed = (self._status(points) != StepStatus.OK)[..., None, None]
        return np.where(failed, np.nan, self._scaled_jacobian(np.clip(points, -1, 1)) / self.scale)

    def _scaled(self, state: ArrayLike, command: ArrayLike) -> Array:
        return (join_points(state, command) - self.centre) / self.scale

    def _scaled_jacobian(self, points: Array) -> Array:
        """∂(next state)/∂point; shape (…, n, d)."""
        return np.einsum("...td,tn->...nd", products_gradient(points, self.degree), self.weights)

    def _status(self, points: Array) -> Codes:
        """A step fails if most of the nearest samples did; shape (…)."""
        finite = np.isfinite(points).all(axis=-1)
        status = np.where(finite, int(StepStatus.OK), int(StepStatus.INVALID))
        if self._tree is not None and finite.any():
            _, nearest = self._tree.query(points[finite], NEIGHBOURS)
            of_neighbours = self.samples.status[nearest]
            failed = np.count_nonzero(of_neighbours != StepStatus.OK, axis=-1) > NEIGHBOURS // 2
            reason = np.max(of_neighbours, axis=-1)  # one of those for which the neighbours failed
            status[finite] = np.where(failed, reason, int(StepStatus.OK))
        return status

    @cached_property
    def _tree(self) -> KDTree | None:
        """Sampled points; None if no step failed."""
        return None if (self.samples.status == StepStatus.OK).all() else KDTree(self.samples.points)

    def to_dict(self) -> dict[str, Any]:
        """Numbers for JSON, from which `surrogate_from_dict` makes the same map."""
        numbers = {name: getattr(self, name).tolist() for name in ("centre", "scale", "weights", "error")}
        failed = self.samples.status != StepStatus.OK
        samples = {
            "points": self.samples.points.tolist(),
            "next_state": np.where(failed[:, None], 0.0, self.samples.next_state).tolist(),
            "status": self.samples.status.tolist(),
        }
        return {"degree": self.degree, **numbers, "samples": samples}


def surrogate_from_dict(space: StepSpace, saved: dict[str, Any]) -> SurrogateMap:
    """The map that `SurrogateMap.to_dict` described."""
    numbers = {name: np.array(saved[name], float) for name in ("centre", "scale", "weights", "error")}
    status = np.array(saved["samples"]["status"], np.int64)
    next_state = np.array(saved["samples"]["next_state"], float)
    next_state[status != StepStatus.OK] = np.nan
    samples = Samples(np.array(saved["samples"]["points"], float), next_state, status)
    return SurrogateMap(space, degree=int(saved["degree"]), samples=samples, **numbers)


def fit_surrogate(
    step_map: StepMap,
    rng: np.random.Generator,
    mapped: MapFunction = map,
    on_samples: Callable[[int, Array], None] = lambda count, error: None,
    good_enough: float = GOOD_ENOUGH,
) -> SurrogateMap:
    """Samples a map, and fits a surrogate to it.

    Args:
        step_map: The map, such as that of a simulator.
        rng: Scrambles the Sobol sequences, and draws the states from which motions go on.
        mapped: How parts of the samples are computed, such as by an executor's `map`.
        on_samples: Called with the number of samples so far and the error of the surrogate [state units].
        good_enough: Error in half ranges of the state below which no further samples are taken.

    Raises:
        StepGapError: Nearly all sampled steps fail.
    """
    motions = Motions(step_map, rng, mapped)
    last_error = np.inf
    samples = motions.begun(FIRST_SAMPLES)
    while True:
        surrogate = _fitted(motions, samples)
        judged = _misjudged(samples) <= MISJUDGED
        on_samples(len(samples.status), surrogate.error)
        error = np.max(surrogate.error / step_map.space.state_scale)
        along_motions = len(samples.status) > FIRST_SAMPLES
        if len(samples.status) >= MOST_SAMPLES or (
            judged and (error <= good_enough or error > WORTHWHILE * last_error)
        ):
            return surrogate
        last_error = error if along_motions else np.inf  # the first steps are all over the ranges
        samples = motions.continued(samples, len(samples.status))


def _misjudged(samples: Samples) -> float:
    """Part of the samples whose neighbours say wrongly that they fail, or that they do not."""
    failed = samples.status != StepStatus.OK
    if failed.all() or not failed.any():
        return 0.0
    _, nearest = KDTree(samples.points).query(samples.points, NEIGHBOURS + 1)
    others = failed[np.asarray(nearest)[:, 1:]]  # the nearest one is the sample itself
    return float(np.mean((np.count_nonzero(others, axis=-1) > NEIGHBOURS // 2) != failed))


def _fitted(motions: Motions, samples: Samples) -> SurrogateMap:
    """The polynomial of the degree with the smallest leave-one-out error of the steps that stay in range."""
    space = motions.space
    centre = motions.centre
    scale = motions.scale
    good = samples.status == StepStatus.OK
    points = samples.points[good]
    next_state = samples.next_state[good]
    far = np.max(np.abs(space.scaled_state(next_state)), axis=1, initial=0) / WIDENED
    weights = np.maximum(far, 1.0)[:, None] ** -2
    counted = far <= 1
    fits = []
    for degree in DEGREES:
        basis = products(points, degree)
        if len(points) < 2 * basis.shape[1] or not counted.any():
            break
        fit = fit_linear(weights * basis, weights * next_state)
        error = np.sqrt(np.mean((fit.left_out / weights)[counted] ** 2, axis=0))
        fits.append((float(np.linalg.norm(error / space.state_scale)), degree, fit.weights, error))
    if not fits:
        raise StepGapError(
            f"only {len(points)} of {len(good)} simulated steps ended with a next state, {np.count_nonzero(counted)} "
            "in the ranges of use; check the ranges of states and commands, and the simulation itself"
        )
    _, degree, best_weights, error = min(fits, key=lambda fit: fit[0])
    return SurrogateMap(space, centre, scale, degree, best_weights, error, samples)


def products(points: Array, degree: int) -> Array:
    """Products of Legendre polynomials up to a total degree; (…, d) to (…, terms)."""
    return np.prod(_factors(_legendre(points, degree), degree), axis=0)


def products_gradient(points: Array, degree: int) -> Array:
    """∂products/∂points; (…, d) to (…, terms, d)."""
    values = _legendre(points, degree)
    derivatives = values[..., :degree] @ legendre.legder(np.eye(degree + 1))
    factors = _factors(values, degree)
    factor_derivatives = _factors(derivatives, degree)
    columns = [
        derivative * np.prod(factors[:axis] + factors[axis + 1 :], axis=0)
        for axis, derivative in enumerate(factor_derivatives)
    ]
    return np.stack(columns, axis=-1)


def _legendre(points: Array, degree: int) -> Array:
    """Legendre polynomials of each coordinate; (…, d) to (…, d, degree + 1)."""
    return np.asarray(legendre.legvander(points, degree), float)


def _factors(values: Array, degree: int) -> list[Array]:
    """The factor of each coordinate in every product; (…, d, degree + 1) to d times (…, terms)."""
    exponents = exponents_of(values.shape[-2], degree)
    return [values[..., axis, exponents[:, axis]] for axis in range(values.shape[-2])]


@cache
def exponents_of(d: int, degree: int) -> Codes:
    """Degree of each coordinate in all products up to a total degree; shape (terms, d)."""
    chosen = [which for size in range(degree + 1) for which in combinations_with_replacement(range(d), size)]
    return np.array([[which.count(axis) for axis in range(d)] for which in chosen])

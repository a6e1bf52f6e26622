"""A surrogate of a slow or rough map: a smooth polynomial fitted to its steps (a response surface).

The inputs are sampled by a Sobol sequence, and the next states fitted by least squares in products of Legendre
polynomials up to a total degree (Santner, Williams & Notz, *The Design and Analysis of Computer Experiments*). The
degree is the one with the smallest leave-one-out error, which needs no further samples and no further fits. The number
of samples is doubled until this error hardly decreases. A simulator with contacts is not smooth on a small scale; the
polynomial is its average there, and the leave-one-out error contains the rest.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cache, cached_property
from itertools import combinations_with_replacement
from typing import Any, Final, NamedTuple, final

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import ArrayLike
from scipy.spatial import KDTree

from stepgap.base.errors import StepGapError
from stepgap.learning.linear_regression import fit_linear
from stepgap.learning.residual import join_points
from stepgap.step import Array, Codes, Outcome, StepMap, StepSpace, StepStatus

WIDENED = 1.25
"""Half the sampled range of a state in half ranges of use, because a robot leaves these at times."""

FIRST_SAMPLES, MOST_SAMPLES = 128, 2048
"""Smallest and largest number of samples; powers of two, for which a Sobol sequence is balanced."""

DEGREES = (1, 2, 3, 4, 5)
"""Total degrees that are tried."""

WORTHWHILE = 0.85
"""The samples are doubled again if that made the error at most this part of the one before."""

GOOD_ENOUGH = 1e-3
"""Error in half ranges of the state below which no further samples are taken, unless another one is given."""

NEIGHBOURS = 3
"""Number of nearest sampled steps; a step fails if most of these failed (classification by nearest neighbours)."""

MISJUDGED = 0.05
"""Samples are added as long as a larger part of them would be judged wrongly by their neighbours."""

MapFunction = Callable[..., Iterable[Outcome]]
"""The function `map`, or that of an executor."""


class Samples(NamedTuple):
    """Simulated steps.

    Attributes:
        points: Scaled states and commands, in −1 … 1; shape (N, d).
        next_state: NaN where a step failed; shape (N, n).
        status: `StepStatus` values; shape (N,).
    """

    points: Array
    next_state: Array
    status: Codes

    def plus(self, more: "Samples") -> "Samples":
        """These and more."""
        return Samples(
            np.concatenate([self.points, more.points]),
            np.concatenate([self.next_state, more.next_state]),
            np.concatenate([self.status, more.status]),
        )


@final
@dataclass(frozen=True, eq=False)
class SurrogateMap(StepMap):
    """A polynomial of state and command, continued linearly outside the sampled range; made by `fit_surrogate`.

    Attributes:
        quantities: Names, units and ranges.
        centre: Middle of the sampled range of states and commands; shape (d,), d = n + m.
        scale: Half that range; shape (d,).
        degree: Largest total degree.
        weights: Of the products of Legendre polynomials; shape (terms, n).
        error: Leave-one-out root-mean-square error [state units]; shape (n,).
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
        known = np.isfinite(points).all(axis=-1)
        status = np.where(known, int(StepStatus.OK), int(StepStatus.INVALID))
        if self._tree is not None and known.any():
            _, nearest = self._tree.query(points[known], NEIGHBOURS)
            found = self.samples.status[nearest]
            failed = np.count_nonzero(found != StepStatus.OK, axis=-1) > NEIGHBOURS // 2
            reason = np.max(found, axis=-1)  # one of those in which the neighbours failed
            status[known] = np.where(failed, reason, int(StepStatus.OK))
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
    """Samples a map and fits a surrogate to it.

    Args:
        step_map: The map, such as that of a simulator.
        rng: Scrambles the Sobol sequence.
        mapped: How parts of the samples are computed, such as by an executor's `map`.
        on_samples: Called with the number of samples so far and the error of the surrogate [state units].
        good_enough: Error in half ranges of the state below which no further samples are taken.

    Raises:
        StepGapError: Nearly all sampled steps fail.
    """
    from scipy.stats import qmc  # the import takes long, and few robots have a surrogate

    space = step_map.space
    centre = np.concatenate([space.state_centre, space.command_centre])
    scale = np.concatenate([WIDENED * space.state_scale, space.command_scale])
    sequence = qmc.Sobol(len(centre), rng=rng)
    samples = _sampled(step_map, sequence.random(FIRST_SAMPLES), centre, scale, mapped)
    found = _fitted(space, centre, scale, samples)
    while True:
        on_samples(len(samples.status), found.error)
        scaled_error, judged = np.max(found.error / space.state_scale), _misjudged(samples) <= MISJUDGED
        if len(samples.status) >= MOST_SAMPLES or (judged and scaled_error <= good_enough):
            return found
        more = _sampled(step_map, sequence.random(len(samples.status)), centre, scale, mapped)
        samples = samples.plus(more)
        found = _fitted(space, centre, scale, samples)
        if judged and np.max(found.error / space.state_scale) > WORTHWHILE * scaled_error:
            on_samples(len(samples.status), found.error)
            return found


SAMPLE_PARTS: Final = 16
"""Number of parts in which samples are computed."""


def _sampled(step_map: StepMap, unit: Array, centre: Array, scale: Array, mapped: MapFunction) -> Samples:
    """Steps from points of the unit cube; shape (N, d)."""
    points, n = 2 * unit - 1, len(step_map.space.state)
    inputs = np.array_split(centre + scale * points, SAMPLE_PARTS)
    outcomes = list(mapped(step_map.evaluate, [part[:, :n] for part in inputs], [part[:, n:] for part in inputs]))
    return Samples(
        points,
        np.concatenate([outcome.next_state for outcome in outcomes]),
        np.concatenate([outcome.status for outcome in outcomes]),
    )


def _misjudged(samples: Samples) -> float:
    """Part of the samples whose neighbours say wrongly that they fail, or that they do not."""
    failed = samples.status != StepStatus.OK
    if failed.all() or not failed.any():
        return 0.0
    _, nearest = KDTree(samples.points).query(samples.points, NEIGHBOURS + 1)
    others = failed[np.asarray(nearest)[:, 1:]]  # the nearest one is the sample itself
    return float(np.mean((np.count_nonzero(others, axis=-1) > NEIGHBOURS // 2) != failed))


def _fitted(space: StepSpace, centre: Array, scale: Array, samples: Samples) -> SurrogateMap:
    """The polynomial of the degree with the smallest leave-one-out error."""
    good = samples.status == StepStatus.OK
    points, next_state = samples.points[good], samples.next_state[good]
    fits = []
    for degree in DEGREES:
        basis = products(points, degree)
        if len(points) < 2 * basis.shape[1]:
            break
        found = fit_linear(basis, next_state)
        error = np.sqrt(np.mean(found.left_out**2, axis=0))
        fits.append((float(np.linalg.norm(error / space.state_scale)), degree, found.weights, error))
    if not fits:
        raise StepGapError(
            f"only {len(points)} of {len(good)} simulated steps ended with a next state; check the ranges of states "
            "and commands, and the simulation itself"
        )
    _, degree, weights, error = min(fits, key=lambda fit: fit[0])
    return SurrogateMap(space, centre, scale, degree, weights, error, samples)


def products(points: Array, degree: int) -> Array:
    """Products of Legendre polynomials up to a total degree; (…, d) to (…, terms)."""
    return np.prod(_factors(_legendre(points, degree), degree), axis=0)


def products_gradient(points: Array, degree: int) -> Array:
    """∂products/∂points; (…, d) to (…, terms, d)."""
    values = _legendre(points, degree)
    derivatives = values[..., :degree] @ legendre.legder(np.eye(degree + 1))
    factors, factor_derivatives = _factors(values, degree), _factors(derivatives, degree)
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

"""`benchmarks.speed gp`: computing times of the Gaussian process.

The kinds of processes take turns within one run, so that a busy machine slows all of them equally: compare ratios, not
times. All have the same kernel (Matérn-5/2 with one length scale per input, and noise), the same data (a smooth
function of four inputs), and one thread for linear algebra, since several threads would wait for each other on a busy
machine.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal

import numpy as np
from threadpoolctl import threadpool_limits

from benchmarks.speed.timing import Announce, machine, timed
from stepgap.base.normal import INTERVAL_95
from stepgap.gauss.gaussian_process import GaussianProcess
from stepgap.gauss.gaussian_process_fit import EXACT_SIZE, fit_gaussian_process
from stepgap.step import Array

GP_PACKAGES = ("stepgap", "numpy", "scipy", "numba")
"""Packages whose versions are part of the result."""

NOISE = 0.008
"""Standard deviation of the noise of a value."""

SCALE, VALUE_SCALE = np.ones(4), 0.2
"""Scales of inputs and values."""


@dataclass(frozen=True)
class GpBenchSize:
    """Size of the benchmark.

    Attributes:
        points: Numbers of points of the fits.
        rounds: Number of turns of the kinds, for each number of points.
        calls: Number of timed predictions.
        queries: Number of points at which the error is measured.
    """

    points: tuple[int, ...]
    rounds: tuple[int, ...]
    calls: int
    queries: int


FULL_GP_BENCH = GpBenchSize(points=(50, 200, 1000, 3000), rounds=(9, 5, 3, 1), calls=200, queries=2000)
QUICK_GP_BENCH = GpBenchSize(points=(50, 200), rounds=(3, 3), calls=50, queries=500)


@dataclass(frozen=True)
class Kind:
    """A kind of Gaussian process.

    Attributes:
        name: Name in the table.
        note: Differences from the others.
        least_points: Smallest number of points; with fewer it is left out.
        most_points: Largest number of points; with more it is left out.
        basis: Basis functions of the mean.
    """

    name: str
    note: str
    least_points: int
    most_points: int
    basis: Literal["constant", "linear"] = "constant"

    def fit(self, points: Array, values: Array) -> GaussianProcess:
        """Process of points (N, 4) and values (N,)."""
        return fit_gaussian_process(points, values, SCALE, VALUE_SCALE, basis=self.basis)


KINDS = (
    Kind("StepGap", "priors; starts compete on at most 100 points", 0, EXACT_SIZE),
    Kind("StepGap, linear basis", "with linear basis functions", 0, EXACT_SIZE, "linear"),
    Kind("StepGap, sparse", "hyper-parameters of 1,000 points", EXACT_SIZE + 1, 10**6),
)


def smooth_function(points: Array) -> Array:
    """The smooth function of points (N, 4) that is fitted; shape (N,)."""
    x, y, u, v = points.T
    return 0.04 + 0.03 * np.sin(1.3 * x + 0.5 * u) + 0.02 * np.tanh(y * v) + 0.01 * u**2


def bench_gp(seed: int, quick: bool, announce: Announce = lambda line: None) -> dict[str, Any]:
    """Runs the benchmark for every number of points; the result is plain data for JSON.

    Args:
        seed: Seed of the random points.
        quick: Whether to use few points.
        announce: Called with the name of each section before it begins.
    """
    size = QUICK_GP_BENCH if quick else FULL_GP_BENCH
    rows: list[dict[str, Any]] = []
    for points, rounds in zip(size.points, size.rounds, strict=True):
        announce(f"{points} points")
        kinds = [kind for kind in KINDS if kind.least_points <= points <= kind.most_points]
        with threadpool_limits(limits=1):
            rows += time_kinds(kinds, np.random.default_rng([seed, points]), points, rounds, size)
    return {
        "schema": 2,
        "quick": quick,
        "seed": seed,
        "machine": machine(GP_PACKAGES),
        "rows": rows,
    }


def time_kinds(
    kinds: list[Kind], rng: np.random.Generator, count: int, rounds: int, size: GpBenchSize
) -> list[dict[str, Any]]:
    """A row for each kind: median times, median ratios to the first one, error and coverage of the fit."""
    points, values = _draw(rng, count)
    queries, observed = _draw(rng, size.queries)
    for kind in kinds:  # compiles
        _predict(kind.fit(points[:20], values[:20]), queries[:1])
    fits = _turns([partial(kind.fit, points, values) for kind in kinds], rounds)
    processes = [kind.fit(points, values) for kind in kinds]
    predictions = _turns([partial(_predict, process, queries[:1]) for process in processes], size.calls)
    rows = []
    for i, (kind, process) in enumerate(zip(kinds, processes, strict=True)):
        mean, std = _predict(process, queries)
        covered = np.abs(observed - mean) < INTERVAL_95 * np.hypot(std, NOISE)
        gradient = partial(_predict_gradient, process, queries[0])
        grow = partial(process.append, queries[0], 0.0)
        rows.append(
            {
                "points": count,
                "name": kind.name,
                "note": kind.note,
                "fit_ms": 1e3 * float(np.median(fits[:, i])),
                "fit_ratio": float(np.median(fits[:, i] / fits[:, 0])),
                "mean_and_std_us": 1e6 * float(np.median(predictions[:, i])),
                "mean_and_std_ratio": float(np.median(predictions[:, i] / predictions[:, 0])),
                "mean_and_gradient_us": 1e6 * float(np.median(_turns([gradient], size.calls))),
                "append_us": 1e6 * float(np.median(_turns([grow], size.calls))),
                "rmse": float(np.sqrt(np.mean((mean - smooth_function(queries)) ** 2))),
                "coverage": float(covered.mean()),
            }
        )
    return rows


def _predict(process: GaussianProcess, queries: Array) -> tuple[Array, Array]:
    return process.mean(queries), process.kriging_std(queries)


def _predict_gradient(process: GaussianProcess, query: Array) -> tuple[Array, Array]:
    return process.mean(query), process.mean_gradient(query)


def _draw(rng: np.random.Generator, count: int) -> tuple[Array, Array]:
    """Random points (count, 4) and noisy values (count,)."""
    points = rng.uniform(-1, 1, (count, 4))
    return points, smooth_function(points) + NOISE * rng.standard_normal(count)


def _turns(calls: list[Callable[[], object]], rounds: int) -> Array:
    """Times of calls that take turns [s]; shape (rounds, calls)."""
    return np.array([[timed(call) for call in calls] for _ in range(rounds)])


def describe_gp_bench(result: dict[str, Any]) -> str:
    """The result as a text table."""
    lines = [
        f"{'points':>6}  {'kind':24}{'fit':>12}{'ratio':>8}{'mean, std':>12}{'ratio':>8}"
        f"{'gradient':>11}{'append':>10}{'error':>9}{'covered':>9}   note"
    ]
    for row in result["rows"]:
        lines.append(
            f"{row['points']:6}  {row['name']:24}{row['fit_ms']:9.1f} ms{row['fit_ratio']:8.1f}"
            f"{row['mean_and_std_us']:9.0f} µs{row['mean_and_std_ratio']:8.1f}{row['mean_and_gradient_us']:8.0f} µs"
            f"{row['append_us']:7.0f} µs{row['rmse']:9.5f}{row['coverage']:9.1%}   {row['note']}"
        )
    lines += [
        "",
        "ratio: to the first kind. gradient: mean and its gradient at one point. error: RMS error of the function;",
        f"the noise is {NOISE}. covered: fraction of new noisy values within the 95 % interval.",
    ]
    return "\n".join(lines)

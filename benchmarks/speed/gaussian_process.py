"""`benchmarks.speed gp`: computing times of the Gaussian process.

Other libraries can be measured with it, as in `benchmarks/compare_gaussian_processes.py`. Libraries take turns within
one run, so that a busy machine slows all of them equally: compare ratios, not times. All have the same kernel
(Matérn-5/2 with one length scale per input, and noise), the same data (a smooth function of four inputs), and one
thread for linear algebra, since several threads would wait for each other on a busy machine.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from benchmarks.speed.timing import Announce, machine, timed
from stepgap.base.normal import INTERVAL_95
from stepgap.gauss.gaussian_process_fit import EXACT_SIZE, fit_gaussian_process
from stepgap.step import Array

GP_PACKAGES = ("stepgap", "numpy", "scipy", "numba", "scikit-learn", "openturns")
"""Packages whose versions are part of the result."""

NOISE = 0.008
"""Standard deviation of the noise of a value."""

SCALE, VALUE_SCALE = np.ones(4), 0.2
"""Scales of inputs and values."""

MOST_STARTS = 5
"""Number of starts of each search for hyper-parameters."""

MANY_STARTS_SIZE = 200
"""Largest number of points for which the peers use all starts; with more points they use one."""


@dataclass(frozen=True)
class GpBenchSize:
    """Size of the benchmark.

    Attributes:
        points: Numbers of points of the fits.
        rounds: Number of turns of the libraries, for each number of points.
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
class Library:
    """An implementation of Gaussian processes.

    Attributes:
        name: Name in the table.
        note: Differences from the others.
        fit: Function of points (N, 4), values (N,) and the number of starts that returns a process.
        predict: Function of a process and queries (Q, 4) that returns means and standard deviations of f.
        most_points: Largest number of points; with more it is left out, because it takes too long.
        least_points: Smallest number of points; with fewer it is left out.
        predict_gradient: Function of a process and a query (4,) that returns mean and gradient.
        append: Function of a process, a point and a value that returns a process.
        starts: Number of starts of its search, if that cannot be chosen.
    """

    name: str
    note: str
    fit: Callable[[Array, Array, int], Any]
    predict: Callable[[Any, Array], tuple[Array, Array]]
    most_points: int
    least_points: int = 0
    predict_gradient: Callable[[Any, Array], Any] | None = None
    append: Callable[[Any, Array, float], Any] | None = None
    starts: int | None = None


def smooth_function(points: Array) -> Array:
    """The smooth function of points (N, 4) that is fitted; shape (N,)."""
    x, y, u, v = points.T
    return 0.04 + 0.03 * np.sin(1.3 * x + 0.5 * u) + 0.02 * np.tanh(y * v) + 0.01 * u**2


@dataclass(frozen=True)
class GpPeers:
    """Other libraries with the same kernel.

    Attributes:
        libraries: Libraries that are available.
        skipped: Names of the others, with the reason why each is left out.
    """

    libraries: Sequence[Library] = ()
    skipped: Mapping[str, str] = field(default_factory=dict)


NO_PEER_LIBRARIES = GpPeers()


def bench_gp(
    seed: int, quick: bool, announce: Announce = lambda line: None, peers: GpPeers = NO_PEER_LIBRARIES
) -> dict[str, Any]:
    """Runs the benchmark for every number of points; the result is plain data for JSON.

    Args:
        seed: Seed of the random points.
        quick: Whether to use few points.
        announce: Called with the name of each section before it begins.
        peers: Other libraries to measure.
    """
    size = QUICK_GP_BENCH if quick else FULL_GP_BENCH
    rows: list[dict[str, Any]] = []
    for points, rounds in zip(size.points, size.rounds, strict=True):
        announce(f"{points} points")
        every = [*_ours(), *peers.libraries]
        libraries = [library for library in every if library.least_points <= points <= library.most_points]
        with threadpool_limits(limits=1):
            rows += time_libraries(libraries, np.random.default_rng([seed, points]), points, rounds, size)
    return {
        "schema": 1,
        "quick": quick,
        "seed": seed,
        "machine": machine(GP_PACKAGES),
        "starts": {"most": MOST_STARTS, "up_to_points": MANY_STARTS_SIZE},
        "rows": rows,
        "skipped": dict(peers.skipped),
    }


def _ours() -> list[Library]:
    def predict(process: Any, queries: Array) -> tuple[Array, Array]:
        return process.mean(queries), process.kriging_std(queries)

    def predict_gradient(process: Any, query: Array) -> tuple[Array, Array]:
        return process.mean(query), process.mean_gradient(query)

    def constant(points: Array, values: Array, starts: int) -> Any:
        return fit_gaussian_process(points, values, SCALE, VALUE_SCALE)

    def linear(points: Array, values: Array, starts: int) -> Any:
        return fit_gaussian_process(points, values, SCALE, VALUE_SCALE, basis="linear")

    both = {
        "predict_gradient": predict_gradient,
        "append": lambda process, point, value: process.append(point, value),
        "starts": MOST_STARTS,
    }
    return [
        Library("StepGap", "priors; starts compete on at most 100 points", constant, predict, EXACT_SIZE, **both),
        Library("StepGap, linear basis", "with linear basis functions", linear, predict, EXACT_SIZE, **both),
        Library(
            "StepGap, sparse", "hyper-parameters of 1,000 points", constant, predict, 10**6, EXACT_SIZE + 1, **both
        ),
    ]


def time_libraries(
    libraries: list[Library], rng: np.random.Generator, count: int, rounds: int, size: GpBenchSize
) -> list[dict[str, Any]]:
    """A row for each library: median times, median ratios to the first library, error and coverage of the fit."""
    points, values = _draw(rng, count)
    queries, observed = _draw(rng, size.queries)
    starts = MOST_STARTS if count <= MANY_STARTS_SIZE else 1
    for library in libraries:  # compiles and imports
        library.predict(library.fit(points[:20], values[:20], 1), queries[:1])
    fits = _turns([partial(library.fit, points, values, starts) for library in libraries], rounds)
    processes = [library.fit(points, values, starts) for library in libraries]
    pairs = list(zip(libraries, processes, strict=True))
    predictions = _turns([partial(library.predict, process, queries[:1]) for library, process in pairs], size.calls)
    rows = []
    for i, (library, process) in enumerate(pairs):
        mean, std = library.predict(process, queries)
        covered = np.abs(observed - mean) < INTERVAL_95 * np.hypot(std, NOISE)
        gradient = library.predict_gradient and partial(library.predict_gradient, process, queries[0])
        grow = library.append and partial(library.append, process, queries[0], 0.0)
        rows.append(
            {
                "points": count,
                "name": library.name,
                "note": library.note,
                "starts": library.starts or starts,
                "fit_ms": 1e3 * float(np.median(fits[:, i])),
                "fit_ratio": float(np.median(fits[:, i] / fits[:, 0])),
                "mean_and_std_us": 1e6 * float(np.median(predictions[:, i])),
                "mean_and_std_ratio": float(np.median(predictions[:, i] / predictions[:, 0])),
                "mean_and_gradient_us": gradient and 1e6 * float(np.median(_turns([gradient], size.calls))),
                "append_us": grow and 1e6 * float(np.median(_turns([grow], size.calls))),
                "rmse": float(np.sqrt(np.mean((mean - smooth_function(queries)) ** 2))),
                "coverage": float(covered.mean()),
            }
        )
    return rows


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
        f"{'points':>6}  {'library':24}{'fit':>12}{'ratio':>8}{'mean, std':>12}{'ratio':>8}"
        f"{'gradient':>11}{'append':>10}{'error':>9}{'covered':>9}   note"
    ]
    for row in result["rows"]:
        gradient, grow = (
            "-" if row[name] is None else f"{row[name]:.0f} µs" for name in ("mean_and_gradient_us", "append_us")
        )
        lines.append(
            f"{row['points']:6}  {row['name']:24}{row['fit_ms']:9.1f} ms{row['fit_ratio']:8.1f}"
            f"{row['mean_and_std_us']:9.0f} µs{row['mean_and_std_ratio']:8.1f}{gradient:>11}{grow:>10}"
            f"{row['rmse']:9.5f}{row['coverage']:9.1%}   {row['note']}, {row['starts']} starts"
        )
    lines += [f"{'':8}{name:24}{'skipped':>12}   {reason}" for name, reason in result["skipped"].items()]
    lines += [
        "",
        "ratio: to StepGap. gradient: mean and its gradient at one point. error: RMS error of the function;",
        f"the noise is {NOISE}. covered: fraction of new noisy values within the 95 % interval.",
    ]
    return "\n".join(lines)

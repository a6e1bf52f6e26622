"""Coverage of new noisy values by the 95 % intervals of a fitted Gaussian process, on random functions.

./go python benchmarks/gp_calibration.py --datasets 20
"""

import argparse
from collections.abc import Callable

import numpy as np
from threadpoolctl import threadpool_limits

from benchmarks.speed.gaussian_process import NOISE, SCALE, VALUE_SCALE, smooth_function
from stepgap.base.normal import INTERVAL_95
from stepgap.gauss.gaussian_process_fit import Basis, fit_gaussian_process
from stepgap.step import Array

SIZES = (3, 5, 10, 20, 30, 50, 100, 200, 500)
BASES: tuple[Basis, ...] = ("constant", "linear")


def draw_function(kind: str, rng: np.random.Generator) -> Callable[[Array], Array]:
    """Random function of points (N, 4) with values like the errors of a step map."""
    if kind == "smooth":
        shift = rng.uniform(-0.5, 0.5, 4)
        return lambda points: smooth_function(points + shift)
    slope, bend, phase = 0.02 * rng.standard_normal(4), rng.standard_normal((3, 4)), rng.uniform(0, 2 * np.pi, 3)
    if kind == "nearly linear":
        return lambda points: points @ slope + 0.005 * np.sin(points @ bend.T + phase).sum(axis=1)
    return lambda points: 0.02 * np.sin(2 * points @ bend.T + phase).sum(axis=1)


def coverage(kind: str, basis: Basis, size: int, datasets: int, seed: int) -> tuple[float, float]:
    """Fraction of new noisy values within the interval, over all data sets, and the smallest of a data set."""
    shares = []
    for dataset in range(datasets):
        rng = np.random.default_rng([seed, size, dataset])
        function = draw_function(kind, rng)
        points, queries = (rng.uniform(-1, 1, (count, 4)) for count in (size, 1000))
        values, observed = (function(x) + NOISE * rng.standard_normal(len(x)) for x in (points, queries))
        process = fit_gaussian_process(points, values, SCALE, VALUE_SCALE, basis=basis)
        std = process.kriging_std(queries, include_noise=True)
        shares.append(float(np.mean(np.abs(observed - process.mean(queries)) < INTERVAL_95 * std)))
    return float(np.mean(shares)), min(shares)


def main() -> None:
    """Prints a row for each kind of function and basis."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--datasets", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    print(f"covered [%], and least of {options.datasets} data sets\n{'points':24}" + "".join(f"{n:>10}" for n in SIZES))
    with threadpool_limits(limits=1):
        for kind in ("smooth", "nearly linear", "wavy"):
            for basis in BASES:
                print(f"{kind + ', ' + basis:24}", end="")
                for size in SIZES:
                    mean, least = coverage(kind, basis, size, options.datasets, options.seed)
                    print(f"{100 * mean:6.1f} {100 * least:3.0f}", end="", flush=True)
                print()


if __name__ == "__main__":
    main()

"""Which difference from the method as published removes the errors that remained on the paper's hardware?

Reads the results of `benchmarks/paper_method.toml`. Prints the errors of the published method by redeployment beside
the hardware's, and those with single differences; then the effect of every difference on the errors of the last and of
the first redeployment: with minus without it, paired over the seeds and over the levels of the other differences, with
95 % intervals by Student's t over the seeds.

    ./go python -m benchmarks.paper_method FOLDER
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks.ratios import half_width
from stepgap.robots.hopper import paper
from stepgap.step import Array
from stepgap.sweep.results_table import ResultsTable, as_numbers, read_results

DIFFERENCES = {"control.cautious": "true", "learning.drift": "true", "learning.residual": "gp"}
"""Settings of ours, by the names of the axes."""

MEASURES = ("rmse", "steady_rmse", "transient_rmse", "true_rmse")


def errors(results: ResultsTable, differences: Sequence[str], iteration: int, name: str) -> Array:
    """Errors [mm/s or mm] of the deployment with these differences and no others; shape (seeds, measures)."""
    here = results.columns["iteration"] == iteration
    for axis, ours in DIFFERENCES.items():
        values = np.array([str(value).lower() for value in results.columns[axis]])
        here &= (values == ours) == (axis in differences)
    order = np.argsort(as_numbers(results.columns["seed"])[here])
    return 1e3 * np.column_stack([results.columns[f"{measure}_{name}"][here][order] for measure in MEASURES])


def interval(samples: Array) -> str:
    """Mean of samples along the first axis, and half the width of its 95 % interval."""
    half = half_width(samples)
    return ", ".join(f"{mean:.1f} ± {width:.1f}" for mean, width in zip(np.mean(samples, axis=0), half, strict=True))


def main() -> None:
    """Prints the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="folder of the sweep")
    results = read_results(parser.parse_args().folder / "results.csv")
    combinations = [[], *([name] for name in DIFFERENCES), list(DIFFERENCES)]
    for name in ("speed", "height"):
        print(f"{name} [mm/s or mm]: {', '.join(MEASURES)}; mean over seeds ± half width of the 95 % interval, range")
        for differences in combinations:
            print(f"  the published method{''.join(f' + {each}' for each in differences)}")
            for iteration in range(paper.LAST_ITERATION + 1):
                found = errors(results, differences, iteration, name)
                lowest, highest = found[:, 0].min(), found[:, 0].max()
                print(f"    {iteration}: {interval(found)}; RMSE {lowest:.1f} to {highest:.1f}")
        hardware = [1e3 * paper.WITH_GP[measure][name] for measure in MEASURES[:3]]
        print(f"  hardware, 4: {', '.join(f'{value:.1f}' for value in hardware)}")
        print(f"  hardware, mean absolute error by iteration: {[1e3 * mae for mae in paper.MAE_BY_ITERATION[name]]}")
        for iteration in (1, paper.LAST_ITERATION):
            print(f"  effect on redeployment {iteration}")
            for axis in DIFFERENCES:
                others = [each for each in DIFFERENCES if each != axis]
                pairs = [
                    errors(results, [*rest, axis], iteration, name) - errors(results, rest, iteration, name)
                    for rest in ([], others[:1], others[1:], others)
                ]
                print(f"    {axis}: alone {interval(pairs[0])}; on average {interval(np.mean(pairs, axis=0))}")


if __name__ == "__main__":
    main()

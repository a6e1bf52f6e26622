"""How well does the monopod track, by method, with several payloads and frictions?

Reads the results of `benchmarks/monopod.toml`. For each method and deployment: falls, and the median and range of all
cases of the root mean square of the errors on settled steps, which are the 6th to the 13th after a change of the
target, because a robot that plans ahead begins with the next change before it is due. Then, in how many cases that was
worse than without correction.

    ./go python benchmarks/monopod.py FOLDER
"""

import argparse
from pathlib import Path

import numpy as np

from stepgap.mujoco_robots.monopod.robot import MONOPOD_SPACE
from stepgap.records.steps_csv import read_step_log
from stepgap.step import Array
from stepgap.sweep.results_table import as_numbers, read_results

PERIOD, SETTLED = 15, slice(5, 13)
"""Steps between changes of the target, and which of these are settled, from 0 on."""


def settled_errors(folder: Path, case: int, iteration: int) -> Array:
    """RMSE of the tracked coordinates on the settled steps of a deployment, NaN without any; shape (3,)."""
    steps = read_step_log(folder / "runs" / f"{case:08}" / "steps.csv", MONOPOD_SPACE).of_iteration(iteration)
    steps = steps.completed()
    here = np.isin((steps.number - 1) % PERIOD, np.arange(PERIOD)[SETTLED])
    squares = (steps.next_state - steps.target)[here][:, MONOPOD_SPACE.tracked] ** 2
    return np.sqrt(np.mean(squares, axis=0)) if here.any() else np.full(squares.shape[1], np.nan)


def main() -> None:
    """Prints the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="folder of the sweep")
    folder = parser.parse_args().folder
    columns = read_results(folder / "results.csv").columns
    cases, iterations = (as_numbers(columns[name]).astype(int) for name in ("case", "iteration"))
    names = [quantity.name for quantity in MONOPOD_SPACE.state if quantity.weight]
    for method in dict.fromkeys(columns["method"]):
        found = []
        for iteration in (0, 1):
            rows = (columns["method"] == method) & (iterations == iteration)
            errors = 1e3 * np.array([settled_errors(folder, case, iteration) for case in cases[rows]])
            spreads = np.nanquantile(errors, [0.5, 0, 1], axis=0).T
            text = ", ".join(f"{n} {m:.1f} ({a:.1f}–{b:.1f})" for n, (m, a, b) in zip(names, spreads, strict=True))
            falls = int(as_numbers(columns["falls"][rows]).sum())
            print(f"{method}, deployment {iteration}, {len(errors)} cases, {falls} falls: {text} [10⁻³]")
            found.append(errors)
        if len(found[0]) == len(found[1]):
            worse = np.sum(found[1] > found[0], axis=0)
            print(f"  worse than deployment 0: {', '.join(f'{n} {w}' for n, w in zip(names, worse, strict=True))}")


if __name__ == "__main__":
    main()

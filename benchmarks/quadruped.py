"""How much does learning help the quadruped, with 3 payloads, 3 frictions and 3 seeds?

Reads the results of `benchmarks/quadruped.toml`. Prints the errors of speed and height without correction, after one
redeployment, and in a first deployment that learns online; and whether any case became worse.

    ./go python benchmarks/quadruped.py FOLDER
"""

import argparse
from pathlib import Path

import numpy as np

from stepgap.mujoco_robots.quadruped.robot import SPACE
from stepgap.records.steps_csv import read_step_log
from stepgap.step import Array
from stepgap.sweep.results_table import ResultsTable, as_numbers, read_results

WINDOW = 10
"""Number of hops over which an error is averaged."""

AXES = ("gap.payload", "gap.friction_scale", "seed")


def errors(results: ResultsTable, online: bool, iteration: int, name: str) -> Array:
    """RMSE of a state coordinate in each case, ordered by the axes; shape (cases,)."""
    here = np.array([str(value).lower() == str(online).lower() for value in results.columns["learning.online"]])
    here &= results.columns["iteration"] == iteration
    order = np.lexsort([as_numbers(results.columns[axis])[here] for axis in reversed(AXES)])
    return results.columns[f"rmse_{name}"][here][order]


def pairs(results: ResultsTable) -> list[tuple[int, int]]:
    """Numbers of the cases without and with learning online that are otherwise equal."""
    online = np.array([str(value).lower() == "true" for value in results.columns["learning.online"]])
    first = results.columns["iteration"] == 0
    cases = [as_numbers(results.columns["case"])[first & (online == wanted)].astype(int) for wanted in (False, True)]
    return list(zip(*cases, strict=True))


def hops_to_half(folder: Path, plain: int, online: int) -> int:
    """Number of hops of a deployment that learns online after which it has half the error of the uncorrected one."""
    before, during = (
        np.convolve(_step_errors(folder, case) ** 2, np.full(WINDOW, 1 / WINDOW), "valid") for case in (plain, online)
    )
    halved = np.sqrt(during / before) <= 0.5
    return int(np.argmax(halved)) if halved.any() else len(during)


def _step_errors(folder: Path, case: int) -> Array:
    """Norm of the error of each step of deployment 0, in half ranges of use; shape (steps,)."""
    log = read_step_log(folder / "runs" / f"{case:08}" / "steps.csv", SPACE).of_iteration(0)
    return np.linalg.norm((log.next_state - log.target) / SPACE.state_scale, axis=1)


def main() -> None:
    """Prints the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="folder of the sweep")
    folder = parser.parse_args().folder
    results = read_results(folder / "results.csv")
    falls = int(np.nansum(results.columns["falls"]))
    print(f"falls: {falls} in {len(results.columns['falls'])} deployments")
    print(
        "RMSE: median (smallest to largest) of all cases; median ratio to the uncorrected one; cases that became worse"
    )
    for name, unit in (("speed", "mm/s"), ("height", "mm")):
        before = 1e3 * errors(results, False, 0, name)
        print(f"{name} [{unit}]")
        print(f"  uncorrected        {np.median(before):6.2f} ({before.min():.2f} to {before.max():.2f})")
        for label, online, iteration in (
            ("one redeployment", False, 1),
            ("online, from step 1", True, 0),
            ("online, redeployed", True, 1),
        ):
            after = 1e3 * errors(results, online, iteration, name)
            ratio, spread = after / before, f"({after.min():.2f} to {after.max():.2f})"
            print(f"  {label:18} {np.median(after):6.2f} {spread}; {np.median(ratio):.2f}; {np.sum(ratio > 1)}")
    hops = [hops_to_half(folder, plain, online) for plain, online in pairs(results)]
    print(f"online: hops until the next {WINDOW} have half the error of the same hops without correction: ", end="")
    print(f"median {np.median(hops):.0f} ({min(hops)} to {max(hops)})")


if __name__ == "__main__":
    main()

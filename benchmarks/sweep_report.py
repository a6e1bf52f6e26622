"""Time and memory of the report of a large sweep, whose table is made up from random numbers.

Four settings follow a Sobol' sequence, which is combined with six twins, two residuals and two seeds. Each case has
three deployments; one case in 50 falls, and one in 500 fails.

    ./go python benchmarks/sweep_report.py [--cases 100000] [--out FOLDER]
"""

import argparse
import math
import resource
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter

import numpy as np
from scipy.stats import qmc

from stepgap.base.random_streams import random_stream
from stepgap.records.summary import MEASURES
from stepgap.robots.hopper.paper import STATE_NAMES
from stepgap.robots.hopper.parameters import CommandBounds
from stepgap.sweep.report.page import report_sweep
from stepgap.sweep.results_table import RESULTS, columns_of, table_text

RANGES = {
    "gap.torque_scale": (0.6, 1.0, False),
    "gap.ground_stiffness": (5e3, 1e5, True),
    "gap.joint_friction": (0.0, 0.1, False),
    "gap.torque_noise": (0.0, 0.05, False),
}
"""Settings of the Sobol' sequence: their ranges, and whether the scale is logarithmic."""

RESIDUALS = ("gp_on_linear", "linear")
TWINS, SEEDS, DEPLOYMENTS = 6, 2, 3


def write_table(path: Path, cases: int) -> None:
    """Writes the table of a sweep with about this many cases."""
    points = 2 ** round(math.log2(max(1, cases / (TWINS * len(RESIDUALS) * SEEDS))))
    names = ("twin", *RANGES, "learning.residual", "seed")
    columns = columns_of(names, CommandBounds().space())
    path.write_text(table_text(columns, _rows(points)), encoding="utf-8")


def _rows(points: int) -> Iterator[list[str]]:
    rng = random_stream(0)
    fractions = qmc.Sobol(len(RANGES), rng=random_stream(1)).random(points)
    twins = rng.normal(0, 0.3, TWINS)
    case = 0
    for twin in range(TWINS):
        for point in fractions:
            values = [f"{_scaled(x, *limits):.12g}" for x, limits in zip(point, RANGES.values(), strict=True)]
            for kind, residual in enumerate(RESIDUALS):
                for seed in range(1, SEEDS + 1):
                    noise = rng.normal(0, 0.15, (DEPLOYMENTS, len(STATE_NAMES)))
                    before = [str(case), str(twin), *values, residual, str(seed)]
                    yield from _case(before, twins[twin] + _effect(point, kind), noise, rng.random(2))
                    case += 1


def _scaled(fraction: float, lower: float, upper: float, logarithmic: bool) -> float:
    return lower * (upper / lower) ** fraction if logarithmic else lower + (upper - lower) * fraction


def _effect(point: np.ndarray, kind: int) -> float:
    """Effect of the settings on the logarithm of the error, with an interaction of torque scale and residual."""
    return -0.9 * point[0] + 0.5 * (point[1] - 0.5) ** 2 + 0.3 * point[3] + kind * (0.2 + 0.5 * (0.5 - point[0]))


def _case(before: list[str], effect: float, noise: np.ndarray, chance: np.ndarray) -> Iterator[list[str]]:
    if chance[0] < 0.002:
        yield [*before, *[""] * (5 + len(MEASURES) * len(STATE_NAMES)), "no command leads to the target <at step 3>"]
        return
    fell = chance[1] < 0.02
    for iteration in range(DEPLOYMENTS):
        learned = -2.0 * (iteration > 0) + effect * (0.4 if iteration == 0 else 1.0)
        errors = np.exp(np.log([0.065, 0.019]) + learned + noise[iteration])
        texts = [repr(float(error)) for error in np.tile(errors, len(MEASURES))]
        falls = str(int(fell and iteration == 1))
        hops = str(int(60 + 200 * errors[0] / 0.0179)) if errors[0] < 0.0179 and iteration else ""
        yield [*before, str(iteration), "none" if iteration == 0 else before[-2], "227", falls, *texts, hops, ""]


def main() -> None:
    """Prints the time and the largest memory of the report."""
    parser = argparse.ArgumentParser(description="Time and memory of the report of a sweep.")
    parser.add_argument("--cases", type=int, default=100_000)
    parser.add_argument("--out", type=Path, help="folder that keeps the table and the report")
    arguments = parser.parse_args()
    with TemporaryDirectory() as name:
        folder = arguments.out or Path(name)
        folder.mkdir(parents=True, exist_ok=True)
        write_table(folder / RESULTS, arguments.cases)
        before, cpu = perf_counter(), resource.getrusage(resource.RUSAGE_SELF)
        page = report_sweep(folder).path
        after = resource.getrusage(resource.RUSAGE_SELF)
        seconds = after.ru_utime + after.ru_stime - cpu.ru_utime - cpu.ru_stime
        size = page.stat().st_size / 1e6
        print(f"table of {(folder / RESULTS).stat().st_size / 1e6:.0f} MB, page of {size:.1f} MB")
        print(f"{perf_counter() - before:.1f} s, of which {seconds:.1f} s on the processor")
        print(f"largest memory: {after.ru_maxrss / 1024:.0f} MB")


if __name__ == "__main__":
    main()

"""Does `stepgap fit` say the same of a log after some of its rows became wrong, and does it name these rows?

Twenty logs of 120 steps with a known error of the nominal map, of which 0, 1 and 5 % of the rows are corrupted: one
number of the state, the command or the next state becomes 1e5, −999, ten times as large, three ranges larger, or zero.
A verdict is unchanged if its value lies in the 95 % interval of the one without wrong rows, or the other way round.
Polynomials are compared: a question of rows, not of residuals.

    ./go python benchmarks/fit_corrupt_rows.py [--logs 20]
"""

import argparse

import numpy as np
from threadpoolctl import threadpool_limits

from stepgap.learning.observations import Observations
from stepgap.learning.steps import Steps
from stepgap.logs.columns import Columns
from stepgap.logs.fits.fit import FitData, compare, without_suspicious
from stepgap.logs.fits.validation import Reduction
from stepgap.records.model_files import NominalSource
from stepgap.step import Array

KINDS = ("none", "constant", "linear", "quadratic")
COLUMNS = Columns(state=("speed", "height"), next=("speed_2", "height_2"), command=("push", "angle"))
STEPS = 120


def data_of(state: Array, command: Array, after: Array, predicted: Array) -> FitData:
    """The steps of a log with these numbers."""
    space, origin = COLUMNS.space(state, command), np.array([str(row) for row in range(len(state))])
    steps = Steps.of_columns(space, state=state, command=command, next_state=after, predicted=predicted)
    observed, source = Observations(space, state, command, after - predicted), NominalSource("predicted")
    return FitData(steps, observed, origin, {}, "", source, COLUMNS)


def log(seed: int) -> tuple[Array, Array, Array, Array]:
    """States, commands, next states and their nominal predictions."""
    rng = np.random.default_rng(seed)
    state, command = rng.uniform([0, 0.5], [0.8, 0.6], (STEPS, 2)), rng.uniform(-2, 2, (STEPS, 2))
    speed = 0.05 + 0.05 * np.sin(3 * state[:, 0]) * command[:, 0]
    height = 0.003 * command[:, 1] ** 2 + 0.02 * state[:, 0]
    predicted = 0.5 * state + command * [0.1, 0.02]
    return (
        state,
        command,
        predicted + np.stack([speed, height], 1) + rng.normal(size=(STEPS, 2)) * [0.01, 0.002],
        predicted,
    )


def corrupted(arrays: tuple[Array, ...], share: float, rng: np.random.Generator) -> tuple[FitData, set[str]]:
    """The steps with some wrong rows, and these rows."""
    changed = [array.copy() for array in arrays]
    rows = rng.choice(STEPS, round(share * STEPS), replace=False)
    for number, row in enumerate(rows):
        array, column = changed[number % 3], rng.integers(2)
        value, extent = array[row, column], float(np.ptp(arrays[number % 3][:, column]))
        array[row, column] = rng.choice([1e5, -999.0, 10 * value, value + 3 * extent, 0.0])
    return data_of(*changed), {str(row) for row in rows}


def gain(data: FitData) -> Reduction:
    """By how much the best residual is better than none."""
    return compare(KINDS, data, None, None).best.gain


def agree(one: Reduction, other: Reduction) -> bool:
    """Whether one value lies in the interval of the other."""
    return abs(one.value - other.value) <= max(one.half_width, other.half_width)


def main() -> None:
    """Prints a line for each share of wrong rows."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--logs", type=int, default=20)
    count = parser.parse_args().logs
    with threadpool_limits(limits=1, user_api="blas"):
        right = [gain(data_of(*log(seed))) for seed in range(count)]
        print("wrong rows | verdict unchanged | with all rows | named | others named | largest change")
        for share in (0.0, 0.01, 0.05):
            changes: list[float] = []
            unchanged, unchanged_with_all, wrong, named, others = 0, 0, 0, 0, 0
            for seed, clean in enumerate(right):
                data, rows = corrupted(log(seed), share, np.random.default_rng(1000 + seed))
                kept, suspicious = without_suspicious(data)
                now = gain(kept)
                unchanged += agree(clean, now)
                unchanged_with_all += agree(clean, gain(data))
                changes.append(abs(now.value - clean.value))
                wrong += len(rows)
                named += len(rows & set(suspicious))
                others += len(set(suspicious) - rows)
            cells = (
                f"{share:.0%}",
                f"{unchanged} of {count}",
                f"{unchanged_with_all} of {count}",
                f"{named} of {wrong}",
                str(others),
                f"{max(changes):.3f}",
            )
            print(" | ".join(cells), flush=True)


if __name__ == "__main__":
    main()

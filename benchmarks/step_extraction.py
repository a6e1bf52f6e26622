"""How well `stepgap steps` finds the hops of logs: missed, duplicated, errors of the state, and rows that are wrong.

    ./go python -m benchmarks.step_extraction [--hops 200] [--seeds 81,82,83,84,85]

The logs are synthetic, so that the truth is known: ballistic flights with random apexes, joined by stances like those
of a spring. Each is made worse in one way, and in all at once: rounded to 0.1 to 5 mm, with noise, with rows that are
lost, with values that the sensor repeats or loses, at two sampling rates, and with glitches in the column of the phase.

A row of steps is wrong if its sections are not two successive true ones, if its plan is that of another step, or if its
state is off by more than five standard errors and by more than a twentieth of the spread of the states. What is left
out is counted, but is not wrong.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from tests.logs.sections.hopping_logs import (
    Change,
    glitches,
    lost_rows,
    lost_values,
    noisy,
    repeated,
    rounded,
    slower,
    slower_forward,
    vibrating,
    weak_force,
)
from tests.logs.sections.scored_steps import Score, trial

CASES: dict[str, tuple[Change, ...]] = {
    "as it is": (),
    **{f"rounded to {step:g} mm": (rounded(step / 1000),) for step in (0.1, 0.5, 1, 2, 5)},
    "noise 2 mm": (noisy(0.002),),
    "noise 10 mm": (noisy(0.01),),
    "vibration 2 mm, 25 Hz": (vibrating(0.002, 25), noisy(0.0002)),
    "force with noise, offset": (weak_force(1.5, 1.0), noisy(0.0002)),
    "rows lost": (lost_rows(40, 0.15),),
    "values lost, zeros": (lost_values(0.01),),
    "values repeated": (repeated(40, 0.08),),
    "rate / 5 from the middle": (slower(5),),
    "position at 100 Hz": (slower_forward(10),),
    "phase with glitches": (glitches(200, 0.02),),
    "phase with long glitches": (glitches(40, 0.15),),
    "all at once, 1 mm": (
        noisy(0.0005), rounded(0.001), lost_values(0.005), repeated(10, 0.03), lost_rows(20, 0.1), glitches(100, 0.02),
    ),
}  # fmt: skip


def summary(scores: Sequence[Score], hops: int) -> str:
    """One row of the table."""
    total = hops * len(scores)
    missed = total - sum(each.found for each in scores)
    extra, silent = sum(each.duplicated for each in scores), sum(each.silent for each in scores)
    errors = np.sqrt(np.mean(np.concatenate([each.errors for each in scores]) ** 2, axis=0))
    ratios = np.sqrt(np.mean(np.concatenate([each.standardised for each in scores]) ** 2, axis=0))
    cells = [
        f"{missed}, {extra} ({silent})",
        f"{sum(each.steps for each in scores)} of {total - len(scores)}",
        f"{sum(each.wrong for each in scores)}",
        f"{1e3 * errors[0]:.2f}, {1e3 * errors[1]:.3f}",
        f"{ratios[0]:.2f}, {ratios[1]:.2f}",
        f"{sum(each.refused for each in scores)}",
    ]
    return " | ".join(cells)


def main() -> None:
    """Prints a row for each case."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--hops", type=int, default=200)
    parser.add_argument("--seeds", default="81,82,83,84,85")
    parser.add_argument("--cases", default="")
    options = parser.parse_args()
    seeds = [int(seed) for seed in options.seeds.split(",")]
    print(
        "case | rule | missed, extra (without doubt) | steps of all | wrong | RMSE of speed, height [mm/s, mm] | "
        "RMS ratio of error to standard error | logs refused"
    )
    for name, changes in CASES.items():
        if options.cases not in name:
            continue
        for rule in ("height", "phase", "force"):
            with TemporaryDirectory() as folder:
                results = [trial(changes, rule, options.hops, seed, Path(folder)) for seed in seeds]
            scores = [each for each in results if isinstance(each, Score)]
            for text in {each for each in results if isinstance(each, str)}:
                print(f"  refused: {text[-150:]}")
            if not scores:
                continue
            print(f"{name} | {rule} | {summary(scores, options.hops)}", flush=True)


if __name__ == "__main__":
    main()

"""Compares what `stepgap fit` says about residuals with what they do in a run.

For each seed: a default run, and `stepgap fit` of it; and for each residual, a run of one redeployment with it alone
(`learning.drift = false`), whose tracking error is measured. Both errors are relative to those of `gp_on_linear` with
the same seed, for both state coordinates together; the table has their geometric means over the seeds, with 95 %
intervals by Student's t.

    ./go python benchmarks/fit_ranking.py --out FOLDER [--seeds 1,2,3,4,5]

Results that are in the folder already are used again. Five seeds take half an hour on two cores.
"""

import argparse
import json
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import t

from stepgap.step import Array

KINDS = ("constant", "linear", "quadratic", "gp", "posterior", "gp_on_linear", "fitrgp")
USED = "gp_on_linear"
STEPGAP = Path(sys.executable).with_name("stepgap")


def result_of(file: Path, *arguments: object) -> dict[str, Any]:
    """Content of a JSON file, written by these arguments of `stepgap` if it does not exist."""
    if not file.is_file():
        subprocess.run([STEPGAP, *map(str, arguments)], check=True, stdout=subprocess.DEVNULL)
    return json.loads(file.read_text())


def fitted_ratios(folder: Path, seed: int) -> dict[str, float]:
    """Held-out error of each residual relative to `USED`, in a default run."""
    run = folder / f"run_{seed}"
    result_of(run / "summary.json", "run", "--seed", seed, "--quiet", "--out", run)
    report = folder / f"fit_{seed}.json"
    found = result_of(report, "fit", run, "--out", report)
    print(f"seed {seed}: best {found['best']['kind']}", flush=True)
    return _relative({each["kind"]: np.array(list(each["rmse"].values())) for each in found["residuals"]})


def tracked_ratios(folder: Path, seed: int) -> dict[str, float]:
    """Tracking error of each residual relative to `USED`, in the first redeployment; infinite after a fall."""
    rmse = {}
    for kind in KINDS:
        run = folder / f"{kind}_{seed}"
        learned = ("--iterations", 1, "--learning.residual", kind, "--learning.drift", "false")
        options = ("--seed", seed, *learned, "--quiet", "--out", run)
        last = result_of(run / "summary.json", "run", *options)["iterations"][1]
        rmse[kind] = np.array(list(last["rmse"].values())) if not last["falls"] else np.full(2, np.inf)
    return _relative(rmse)


def _relative(rmse: Mapping[str, Array]) -> dict[str, float]:
    """Errors of the state coordinates relative to those of `USED`, together."""
    return {kind: float(np.sqrt(np.mean((errors / rmse[USED]) ** 2))) for kind, errors in rmse.items()}


def mean_with_interval(ratios: list[float]) -> str:
    """Geometric mean and 95 % interval."""
    logs = np.log(ratios)
    half = t.ppf(0.975, len(logs) - 1) * logs.std(ddof=1) / np.sqrt(len(logs))
    return f"{np.exp(logs.mean()):.2f} ({np.exp(logs.mean() - half):.2f}–{np.exp(logs.mean() + half):.2f})"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--seeds", default="1,2,3,4,5")
    arguments = parser.parse_args()
    seeds = [int(seed) for seed in arguments.seeds.split(",")]
    arguments.out.mkdir(parents=True, exist_ok=True)
    fitted = [fitted_ratios(arguments.out, seed) for seed in seeds]
    tracked = [tracked_ratios(arguments.out, seed) for seed in seeds]
    print(f"{'residual':14}{'held-out, fit':22}tracking, redeployment 1")
    for kind in KINDS:
        columns = [mean_with_interval([ratios[kind] for ratios in table]) for table in (fitted, tracked)]
        print(f"{kind:14}{columns[0]:22}{columns[1]}")


if __name__ == "__main__":
    main()

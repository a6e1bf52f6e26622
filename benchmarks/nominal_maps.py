"""Does a crude nominal map learn as well as the equations of motion? The hopper on random twins, online from hop 1.

Three nominal maps: the equations; a template with a limit cycle that is none of the robot's and four derivatives, each
0.7 of the true one with one digit; and a map fitted to the steps of another twin, the preset `paper`, which learned
online after 60 exploratory hops. Each is used in a sweep over twins and seeds with two deployments that learn online.

    ./go python -m benchmarks.nominal_maps FOLDER
"""

import argparse
import subprocess
from pathlib import Path

import numpy as np

from benchmarks.ratios import ratio
from stepgap.step import Array
from stepgap.sweep.results_table import ResultsTable, as_numbers, read_results

TEMPLATE = """step.state = { speed = 0.2, height = 0.58 }
step.command = { fx = 0.0, fy = 0.0 }

[derivatives.speed]
speed = 0.5
fx = 0.014

[derivatives.height]
height = 0.63
fy = 0.0028
"""
FILES = {"equations": "", "template": "template.toml", "log": "log.csv"}
SEEDS, LOG_SEED = (9801, 9802, 9803), 9800


def prepare(folder: Path, twins: int) -> None:
    """Writes the template, the log, and a sweep for each kind of nominal map."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "template.toml").write_text(TEMPLATE)
    if not (folder / "log.csv").exists():
        words = ["--seed", str(LOG_SEED), "--iterations", "0", "--explore", "60", "--out", str(folder / "logrun")]
        subprocess.run(["stepgap", "run", *words, "--quiet"], check=True)
        (folder / "log.csv").write_bytes((folder / "logrun" / "steps.csv").read_bytes())
    for kind, file in FILES.items():
        base = f'[learning]\nonline = true\niterations = 1\n[nominal]\nkind = "{kind}"\nfile = "{file}"\n'
        (folder / f"base_{kind}.toml").write_text(base)
        axes = '[axes]\n"learning.iterations" = [1]\n'
        sweep = f'base = "base_{kind}.toml"\ntwins = {twins}\nseeds = {list(SEEDS)}\nkeep = "nothing"\n\n{axes}'
        (folder / f"sweep_{kind}.toml").write_text(sweep)


def of_iteration(results: ResultsTable, name: str, iteration: int) -> Array:
    """Values of a column in one deployment of every case; shape (cases,)."""
    return as_numbers(results.columns[name])[results.columns["iteration"] == iteration]


def by_twin(results: ResultsTable, name: str, iteration: int) -> Array:
    """Mean logarithm of an error in one deployment over the seeds of each twin; shape (twins,)."""
    twins, errors = of_iteration(results, "twin", iteration), of_iteration(results, name, iteration)
    return np.array([np.mean(np.log(errors[twins == twin])) for twin in np.unique(twins)])


def main() -> None:
    """Runs what is missing and prints the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="folder of the sweeps")
    parser.add_argument("--twins", type=int, default=20)
    arguments = parser.parse_args()
    folder: Path = arguments.folder
    if not (folder / "sweep_log.toml").exists():
        prepare(folder, arguments.twins)
    print("nominal map: hops to the band, median (quartiles), cases that reach it; RMSE online and redeployed; falls")
    found: dict[str, ResultsTable] = {}
    for kind in FILES:
        out = folder / f"out_{kind}"
        if not (out / "results.csv").exists():
            words = ["sweep", str(folder / f"sweep_{kind}.toml"), "--out", str(out), "--quiet"]
            subprocess.run(["stepgap", *words, *(["--resume"] if out.exists() else [])], check=True)
        results = found[kind] = read_results(out / "results.csv")
        last = of_iteration(results, "hops_to_band", 1)
        hops = np.where(np.isnan(last), np.inf, last)
        low, middle, high = np.quantile(hops, [0.25, 0.5, 0.75], method="inverted_cdf")
        falls = [int(of_iteration(results, "falls", iteration).sum()) for iteration in (0, 1)]
        print(f"{kind}: {middle:.0f} ({low:.0f}, {high:.0f}), {np.isfinite(hops).sum()} of {len(hops)};", end="")
        for iteration in (0, 1):
            errors = [1e3 * np.median(of_iteration(results, f"rmse_{name}", iteration)) for name in ("speed", "height")]
            print(f" {errors[0]:.1f} mm/s, {errors[1]:.2f} mm;", end="")
        print(f" falls {falls[0]}, {falls[1]}")
    print("error relative to that with the equations, with its 95 % interval: speed, height")
    for kind, results in found.items():
        for iteration in (0, 1) if kind != "equations" else ():
            logs = [
                by_twin(results, f"rmse_{name}", iteration) - by_twin(found["equations"], f"rmse_{name}", iteration)
                for name in ("speed", "height")
            ]
            ratios = map(ratio, logs)
            print(f"{kind}, deployment {iteration}: {', '.join(ratios)}")


if __name__ == "__main__":
    main()

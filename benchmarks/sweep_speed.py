"""Speed of a sweep: two processes against one, dask against processes, and the planning of 10,000 cases.

Whole commands are timed on an idle machine with at least two cores, alternately, and the medians are compared. The dask
scheduler and its two workers are started before, each as a process that is reached over TCP.

    ./go python benchmarks/sweep_speed.py --rounds 3
"""

import argparse
import resource
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from time import perf_counter, sleep

SWEEP = [sys.executable, "-c", "from stepgap.cli.app import main; main()", "sweep"]
SCHEDULER = [sys.executable, "-m", "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0"]
WORKER = [sys.executable, "-m", "distributed.cli.dask_worker", "--host", "127.0.0.1", "--nthreads", "1"]

PLAN = """
twins = 100
seeds = [1, 2, 3, 4, 5, 6, 7, 8, 9, 10]
[axes]
"learning.residual" = ["gp_on_linear", "linear"]
"gap.body_mass_scale" = { from = 0.9, to = 1.1, points = 5 }
"""
"""A sweep of 10,000 cases."""


def main() -> None:
    """Prints the times and their ratios."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=3)
    rounds = parser.parse_args().rounds
    with tempfile.TemporaryDirectory(prefix="sweep_speed_") as name:
        home = Path(name)
        (home / "plan.toml").write_text(PLAN)
        begin = perf_counter()
        subprocess.run([*SWEEP, "plan.toml", "--plan"], cwd=home, check=True, stdout=subprocess.DEVNULL)
        memory = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024
        print(f"10,000 cases planned: {perf_counter() - begin:.1f} s, {memory:.0f} MiB", flush=True)
        _write_sweep(home, "short", steps=6, cases=200)
        _write_sweep(home, "long", steps=45, cases=40)
        ways = {"one process": ["--processes", "1"], "two processes": ["--processes", "2"]}
        one, two = _compared(home, "short", ways, rounds)
        print(f"efficiency of two processes, 200 cases: {one / (2 * two):.3f}", flush=True)
        with _dask(home):
            ways = {"two processes": ["--processes", "2"], "dask": ["--dask", "dask.json"]}
            processes, dask = _compared(home, "long", ways, rounds)
        print(f"overhead of dask, 40 cases of {2 * processes / 40:.1f} s: {dask / processes - 1:+.1%}")


def _write_sweep(home: Path, name: str, steps: int, cases: int) -> None:
    """Writes a sweep of experiments with two deployments of this number of steps."""
    targets = ["0,0.55"] * 2 + ["0.17,0.58"] * (steps - 2)
    (home / f"{name}.csv").write_text("speed,height\n" + "".join(f"{target}\n" for target in targets))
    (home / f"{name}_base.toml").write_text(f'reference = "{name}.csv"\n[learning]\niterations = 1\n')
    (home / f"{name}.toml").write_text(f'base = "{name}_base.toml"\nseeds = {list(range(cases))}\n')


def _compared(home: Path, name: str, ways: dict[str, list[str]], rounds: int) -> list[float]:
    """Median time of a sweep in each way, which take turns; the tables must be the same [s]."""
    times: dict[str, list[float]] = {way: [] for way in ways}
    tables = set()
    for number in range(rounds):
        for way, options in ways.items():
            folder = home / f"{name}_{number}_{way}".replace(" ", "_")
            begin = perf_counter()
            command = [*SWEEP, f"{name}.toml", "--out", folder.name, "--quiet", *options]
            subprocess.run(command, cwd=home, check=True, stdout=subprocess.DEVNULL)
            times[way].append(perf_counter() - begin)
            tables.add((folder / "results.csv").read_bytes())
    if len(tables) > 1:
        raise SystemExit("the tables differ")
    for way, found in times.items():
        print(f"{name}, {way}: {', '.join(f'{time:.1f}' for time in found)} s", flush=True)
    return [statistics.median(found) for found in times.values()]


@contextmanager
def _dask(home: Path) -> Iterator[None]:
    """Starts a scheduler and two workers."""
    processes = []
    try:
        with (home / "dask.log").open("w") as log:
            options = ["--no-dashboard", "--scheduler-file", "dask.json"]
            processes.append(subprocess.Popen([*SCHEDULER, *options], cwd=home, stdout=log, stderr=log))
            while not (home / "dask.json").exists():
                sleep(0.1)
            for _ in range(2):
                processes.append(subprocess.Popen([*WORKER, *options], cwd=home, stdout=log, stderr=log))
            yield
    finally:
        for process in processes:
            process.terminate()
            process.wait()


if __name__ == "__main__":
    main()

"""Kills `stepgap run` at random times and resumes it; the record must equal that of an uninterrupted run.

    ./go python benchmarks/kill_and_resume.py [--kills 10] [--seed 0] [--iterations 1] [--steps 40]

Half of the kills are applied to one run, which is resumed after each; each other kill is applied to a separate run. A
kill comes up to 50 ms after a random step was written, which may be the last one of a deployment. Then every run is
resumed to its end, and all files except figures, report and times are compared byte by byte. Exits with 1 if one
differs.
"""

import argparse
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from stepgap.records.times_file import TIMES_FILE
from stepgap.robots.hopper.paper import paper_reference

STEPGAP = [sys.executable, "-c", "from stepgap.cli.app import main; main()"]


def main() -> None:
    parser = argparse.ArgumentParser(description="Kills stepgap run and resumes it.")
    parser.add_argument("--kills", type=int, default=10, help="number of kills")
    parser.add_argument("--seed", type=int, default=0, help="seed of the random times")
    parser.add_argument("--iterations", type=int, default=1, help="number of redeployments")
    parser.add_argument("--steps", type=int, default=40, help="number of the paper's targets")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        failures = sum(benchmark(Path(name), arguments))
    print(f"{arguments.kills} kills, {failures} failures")
    sys.exit(failures > 0)


def benchmark(folder: Path, arguments: argparse.Namespace) -> Iterator[bool]:
    """Yields for each run whether it differs from an uninterrupted one."""
    reference = paper_reference()
    targets = reference.targets[: arguments.steps].tolist()
    rows = [",".join(reference.names), *(",".join(map(repr, target)) for target in targets)]
    (folder / "targets.csv").write_text("\n".join(rows) + "\n")
    start = ["--reference", str(folder / "targets.csv"), "--iterations", str(arguments.iterations)]
    run(folder / "uninterrupted", start)
    total = len(lines_of(folder / "uninterrupted"))
    print(f"uninterrupted run: {total - 1} steps\n run  kill  lines before  killed at  lines after  last line complete")
    rng, expected = np.random.default_rng(arguments.seed), record(folder / "uninterrupted")
    chained = arguments.kills // 2
    for number, kills in enumerate([chained, *[1] * (arguments.kills - chained)]):
        killed, failed = folder / f"killed_{number}", False
        for kill, line in enumerate(np.sort(rng.integers(0, total + 1, kills)), start=1):
            before = lines_of(killed)
            run(killed, start, kill_at=int(line), delay=float(rng.uniform(0.0, 0.05)))
            after = lines_of(killed)
            same = min(len(before), len(after))  # an interrupted deployment begins again over its rows
            failed = failed or after[:same] != before[:same]
            print(
                f"{number:4}  {kill:4}  {len(before):12}  {line:9}  {len(after):11}  {has_complete_end(killed)}",
                flush=True,
            )
        run(killed, start)
        different = sorted({name for name, _ in record(killed).items() ^ expected.items()})
        print(f"{number:4}   end  {'DIFFERENT: ' + ', '.join(different) if different else 'equal'}", flush=True)
        yield failed or bool(different)


def run(folder: Path, start: list[str], kill_at: int | None = None, delay: float = 0.0) -> None:
    """Starts or resumes a run; kills it a delay [s] after `steps.csv` has `kill_at` lines, unless it has ended."""
    options = ["--resume"] if (folder / "experiment.toml").exists() else start
    process = subprocess.Popen([*STEPGAP, "run", "--out", folder, "--quiet", *options], stdout=subprocess.DEVNULL)
    while kill_at is not None and process.poll() is None:
        if len(lines_of(folder)) >= kill_at:
            time.sleep(delay)
            process.send_signal(signal.SIGKILL)
            process.wait()
            return
        time.sleep(0.001)
    if process.wait():
        sys.exit(f"stepgap run --out {folder} {' '.join(options)} ended with {process.returncode}")


def lines_of(folder: Path) -> list[str]:
    """Complete lines of `steps.csv`."""
    path = folder / "steps.csv"
    text = path.read_text() if path.exists() else ""
    return text[: text.rfind("\n") + 1].splitlines()


def has_complete_end(folder: Path) -> str:
    """Whether the last line of `steps.csv` is complete."""
    path = folder / "steps.csv"
    return "no file" if not path.exists() else "yes" if path.read_bytes()[-1:] in (b"\n", b"") else "no"


def record(folder: Path) -> dict[str, bytes]:
    """Contents of all files except figures, report and times."""
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file() and path.suffix not in (".png", ".html") and path.name != TIMES_FILE
    }


if __name__ == "__main__":
    main()

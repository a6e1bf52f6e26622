"""Kills processes of a sweep at random moments and continues it: no result is lost or computed twice.

Each round starts the sweep in one of three ways (processes of this machine, two shards that share a folder, a dask
cluster of a scheduler and two workers over TCP), waits a random time, kills one process with SIGKILL, ends the others,
and checks that all earlier results are the same files as before. A folder whose cases are all finished is compared with
the table of an undisturbed sweep, and the next round starts a new one.

    ./go python benchmarks/kill_sweep.py --kills 50
"""

import argparse
import os
import signal
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from time import monotonic, sleep

import numpy as np

CASES = 40
"""Number of cases of the sweep."""

LONGEST = 8.0
"""Longest time between the first new result of a round and the kill [s]."""

SWEEP = [sys.executable, "-c", "from stepgap.cli.app import main; main()", "sweep"]
SCHEDULER = [
    sys.executable,
    "-m",
    "distributed.cli.dask_scheduler",
    "--host",
    "127.0.0.1",
    "--port",
    "0",
    "--no-dashboard",
]
WORKER = [
    sys.executable,
    "-m",
    "distributed.cli.dask_worker",
    "--host",
    "127.0.0.1",
    "--nthreads",
    "1",
    "--no-dashboard",
]

Victims = dict[str, list[int]]
"""Process numbers that may be killed, by kind."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    rng = np.random.default_rng(options.seed)
    with tempfile.TemporaryDirectory(prefix="kill_sweep_") as name:
        home = Path(name)
        _write_sweep(home)
        subprocess.run([*SWEEP, "s.toml", "--out", "undisturbed", "--processes", "1", "--quiet"], cwd=home, check=True)
        table = (home / "undisturbed" / "results.csv").read_bytes()
        kills: Counter[str] = Counter()
        finished = 0
        while kills.total() < options.kills:
            folder = home / f"sweep{finished}"
            way = str(rng.choice(["processes", "shards", "dask"]))
            before = _results(folder)
            with _started(way, home, folder) as victims:
                kind = _kill_one(victims, folder, len(before), rng)
            after = _results(folder)
            if not before.items() <= after.items():
                raise SystemExit(f"after the kill of a {kind}, an earlier result was lost or computed again")
            if kind:
                kills[f"{kind} of {way}"] += 1
            print(
                f"{kills.total():3} {way:9} {kind or 'finished first':22} {len(before)} → {len(after)} results",
                flush=True,
            )
            if len(after) == CASES:
                command = [*SWEEP, "--out", str(folder), "--resume", "--quiet"]
                subprocess.run(command, cwd=home, check=True, stdout=subprocess.DEVNULL)
                if (folder / "results.csv").read_bytes() != table:
                    raise SystemExit(f"{folder}: its table differs from that of the undisturbed sweep")
                finished += 1
        print(f"{kills.total()} kills: {dict(kills)}; {finished} sweeps finished, all with the same table")


def _write_sweep(home: Path) -> None:
    """Writes a sweep of short experiments."""
    targets = ["0,0.55", "0,0.55", "0.17,0.58", "0.17,0.58"]
    (home / "short.csv").write_text("speed,height\n" + "".join(f"{target}\n" for target in targets))
    (home / "e.toml").write_text('reference = "short.csv"\n[learning]\niterations = 1\n')
    seeds = list(range(CASES // 2))
    (home / "s.toml").write_text(f'base = "e.toml"\nseeds = {seeds}\n[axes]\n"gap.body_mass_scale" = [0.95, 1.05]\n')


def _results(folder: Path) -> dict[str, tuple[int, int]]:
    """File number and time of change of every result."""
    return {path.name: (path.stat().st_ino, path.stat().st_mtime_ns) for path in folder.glob("cases/*/*.json")}


@contextmanager
def _started(way: str, home: Path, folder: Path) -> Iterator[Victims]:
    """Starts or continues the sweep in one of the ways; ends all its processes."""
    processes: list[subprocess.Popen[bytes]] = []

    def start(*command: str) -> int:
        log = (home / "log.txt").open("ab")
        processes.append(subprocess.Popen(command, cwd=home, stdout=log, stderr=log))
        return processes[-1].pid

    sweep = [*SWEEP, "s.toml", "--out", str(folder)]
    try:
        if way == "processes":
            yield {"client": [start(*sweep, "--resume", "--processes", "2")], "worker": []}
        elif way == "shards":
            yield {
                "shard": [start(*sweep, "--shard", f"{index}/2", "--processes", "1") for index in (1, 2)],
                "worker": [],
            }
        else:
            (home / "dask.json").unlink(missing_ok=True)
            scheduler = start(*SCHEDULER, "--scheduler-file", "dask.json")
            while not (home / "dask.json").exists():
                sleep(0.05)
            workers = [start(*WORKER, "--no-nanny", "--scheduler-file", "dask.json") for _ in range(2)]
            client = start(*sweep, "--resume", "--dask", "dask.json")
            yield {"scheduler": [scheduler], "dask worker": workers, "client": [client]}
    finally:
        for process in processes:
            process.send_signal(signal.SIGTERM)
        end = monotonic() + 20
        for process in processes:
            try:
                process.wait(max(0.1, end - monotonic()))
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


def _kill_one(victims: Victims, folder: Path, known: int, rng: np.random.Generator) -> str:
    """Kills one process at a random moment; returns its kind, empty if the sweep was finished before."""
    clients = victims.get("client", victims.get("shard", []))
    while len(_results(folder)) == known and any(map(_runs, clients)):
        sleep(0.02)
    moment = monotonic() + rng.uniform(0, LONGEST) ** 2 / LONGEST
    while monotonic() < moment and any(map(_runs, clients)):
        sleep(0.02)
    found = dict(victims)
    if "worker" in found:
        found["worker"] = [child for client in clients for child in _children(client)]
    alive = {kind: [pid for pid in pids if _runs(pid)] for kind, pids in found.items()}
    kinds = sorted(kind for kind, pids in alive.items() if pids)
    if not kinds or len(_results(folder)) == CASES:
        return ""
    kind = str(rng.choice(kinds))
    with suppress(ProcessLookupError):
        os.kill(int(rng.choice(alive[kind])), signal.SIGKILL)
    sleep(float(rng.uniform(0, 3)))
    return kind


def _runs(pid: int) -> bool:
    """Whether a process exists that has not ended."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def _children(pid: int) -> list[int]:
    """Processes that a process has started."""
    try:
        tasks = list(Path(f"/proc/{pid}/task").glob("*/children"))
        return [int(child) for task in tasks for child in task.read_text().split()]
    except OSError:
        return []


if __name__ == "__main__":
    main()

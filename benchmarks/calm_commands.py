"""What a limit of the change of commands does: how much they jump at unchanged targets, and how well the robot tracks.

Each random individual learns twice with the same noise, without a limit and with `--limit`; the last deployment of both
is compared. A jump is the change of a command from a step to the next one with the same target, as a part of its range;
the table has the median of all steps, commands and individuals, and in how many of a hundred steps a command jumped by
more than half of its range. The error is that of the measured states in half ranges.

    ./go python -m benchmarks.calm_commands [--robots hopper,quadruped,monopod,velocity] [--first 96001] [--count 5]
        [--limit 0.1]

A robot is a name or a file of settings.
"""

import argparse
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np

import stepgap
from benchmarks.ratios import ratio
from stepgap.report.reasons import changes_at_constant_targets
from stepgap.step import Array

FAR = 0.5  # Part of a command's range from which on a change is counted as a large jump


class Learned(NamedTuple):
    """The last deployment of a run.

    Attributes:
        jumps: Changes of the commands at unchanged targets, as parts of their ranges; shape (k, m).
        error: Root of the mean square of all errors [half ranges].
        fell: Whether a step failed.
    """

    jumps: Array
    error: float
    fell: bool


def learned(robot: str, number: int, limit: float) -> Learned:
    """Two redeployments of an individual with a limit of the change of commands."""
    control = {"largest_change": limit}
    with TemporaryDirectory() as folder:
        out = Path(folder) / "run"
        gap = f"random:{number}"
        run = stepgap.run(robot, out=out, gap=gap, seed=number, iterations=2, progress=False, control=control)
        last = run.steps.of_iteration(run.deployments[-1].iteration).tracking()
        done = last.completed()
        errors = (done.next_state - done.target) / run.space.state_scale
        jumps = changes_at_constant_targets(last)
        return Learned(jumps, float(np.sqrt(np.nanmean(errors**2))), len(done) < len(last))


def row_of(robot: str, numbers: range, limit: float) -> str:
    """The row of a robot, in Markdown."""
    pairs = [(learned(robot, number, 1.0), learned(robot, number, limit)) for number in numbers]
    cells = list[str]()
    for free_or_limited in zip(*pairs, strict=True):
        jumps = np.concatenate([one.jumps.ravel() for one in free_or_limited])
        large = np.concatenate([(one.jumps > FAR).any(axis=1) for one in free_or_limited])
        cells += [f"{100 * np.median(jumps):.1f} %", f"{100 * large.mean():.0f}"]
    logs = [np.log(limited.error / free.error) for free, limited in pairs]
    falls = [sum(one.fell for one in side) for side in zip(*pairs, strict=True)]
    return f"| {Path(robot).parent.name or robot} | {' | '.join(cells)} | {ratio(logs)} | {falls[0]}, {falls[1]} |"


def main() -> None:
    """Prints a row for each robot as soon as it is done."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robots", default="hopper,quadruped,monopod,velocity")
    parser.add_argument("--first", type=int, default=96001)
    parser.add_argument("--count", type=int, default=5)
    parser.add_argument("--limit", type=float, default=0.1)
    given = parser.parse_args()
    print(
        "| robot | jump | large jumps in 100 steps | jump, limited | large, limited | error, limited / free | falls |"
    )
    print("|---|---|---|---|---|---|---|")
    for robot in given.robots.split(","):
        print(row_of(robot, range(given.first, given.first + given.count), given.limit), flush=True)


if __name__ == "__main__":
    main()

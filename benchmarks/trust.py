"""Does learning make a robot fall, or do worse than without? Pairs of equal runs over many robots and planted changes.

A case is a random robot with random targets, of which something is planted in both redeployments: nothing; a change of
the robot (a load) from the middle on; pushes; two measured states that are wrong by 1 to 3 half ranges; or a warm start
from wrong steps, known before deployment 0 (`benchmarks/wrong_warm_start.py`). It is run by `run_experiment`
without learning, by default and online, each with a deployment 0 and redeployments 1 and 2, and with the same noise and
the same events. A deployment counts where its method knows something: from redeployment 1 on, and also deployment 0
online or with a warm start.

*Extra falls*: deployments that ended before the last target with learning but not without, less those that did so only
without. Their bound is the one-sided 97.5 % bound of Clopper and Pearson of the first number alone, deployments being
taken as independent: it is not less than that of the difference. *Worse than noise*: the squared errors in half ranges,
step by step, exceed those without learning by more than 3 standard errors, from the means of blocks of N^(1/3) steps,
and their root mean square by more than 10 %. A deployment in which one of the two fell is judged up to the fall.

    ./go python -m benchmarks.trust --out trust.jsonl [--robots walker,stroller,hopper,quadruped,monopod] [--cases 40]
        [--first-seed 1000] [--policy FOLDER] [--methods default,online] [--largest-change 0.25]

`--out` receives a line of JSON for each case as soon as it is done; cases in it are not computed again, so an
interrupted run continues where it was. `--policy` is the folder of a Go1 policy, and adds the robot `go1`.
"""

import argparse
import json
import tempfile
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import count, product
from pathlib import Path
from time import process_time
from typing import Any, NamedTuple

import numpy as np
from scipy.stats import beta

from benchmarks.disturbed_plant import METHODS, UNCORRECTED, DisturbedPlant, finished, squared_errors
from benchmarks.trust_robots import TrustRobot, robots
from benchmarks.wrong_warm_start import SOURCES, known_steps
from stepgap.base.random_streams import random_stream
from stepgap.control.settings import ControlSettings
from stepgap.experiment.loop import Observer, Plants, Setup, run_experiment
from stepgap.learning.settings import LearningSettings
from stepgap.learning.steps import LoggedStep, Steps
from stepgap.plants.plant import Plant
from stepgap.rigs.rig import RigFault
from stepgap.step import Array

PLANTED = ("none", "change", "pushes", "measurements", "warm start")
"""What is planted; case N has the one at N modulo their number."""

WRONG = tuple(source for source in SOURCES if source not in ("right", "fleet", "offset"))
"""Sources of warm starts, used in turn."""

REDEPLOYMENTS = 2
PUSH_RATE, PUSHES = 0.03, (0.5, 1.5)
"""Part of the steps after which the robot is pushed, and by how much [half ranges of its forward speed]."""

STANDARD_ERRORS, RATIO = 3.0, 1.1
"""From which difference a deployment is worse than one without learning."""

Row = Mapping[str, Any]


class Case(NamedTuple):
    """One case."""

    robot: str
    number: int
    policy: Path | None
    control: ControlSettings

    @property
    def planted(self) -> str:
        """What is planted in it."""
        return PLANTED[self.number % len(PLANTED)]


def wrong_measurements(robot: TrustRobot, case: Case, deployment: int) -> Mapping[int, Array]:
    """What is added to measured states of a deployment, by the number of the step; shape (n,)."""
    if case.planted != "measurements" or not deployment:
        return {}
    steps, space, draw = len(robot.reference), robot.nominal.space, random_stream(case.number, 5, deployment)
    wrong = draw.choice(np.arange(steps // 4, steps - 1), 2, replace=False) + 1
    one = np.eye(len(space.state))[draw.integers(0, len(space.state), 2)]
    sizes = draw.uniform(1, 3, (2, 1)) * draw.choice([-1, 1], (2, 1)) * space.state_scale * one
    return dict(zip(wrong.tolist(), sizes, strict=True))


def plant_of(robot: TrustRobot, case: Case, deployment: int, rng: np.random.Generator) -> Plant:
    """Plant of a deployment, with what is planted in it."""
    live, steps, draw = robot.live(rng), len(robot.reference), random_stream(case.number, 6, deployment)
    events: dict[int, Callable[[], None]] = {}
    if deployment and case.planted == "change":
        events = {steps // 2: live.change}
    if deployment and case.planted == "pushes":
        sizes = robot.nominal.space.state_scale[0] * draw.uniform(*PUSHES, steps) * draw.choice([-1, 1], steps)
        pushed = np.flatnonzero(draw.random(steps) < PUSH_RATE).tolist()
        events = {k + 1: partial(live.push, float(sizes[k])) for k in pushed}
    return DisturbedPlant(live.plant, events, wrong_measurements(robot, case, deployment))


def run(robot: TrustRobot, case: Case, learning: LearningSettings, known: Steps | None) -> list[Steps]:
    """Steps of the deployments of a run."""
    number, log = count(), list[LoggedStep]()
    plants = Plants(lambda rng: plant_of(robot, case, next(number), rng))
    learning = replace(learning, iterations=REDEPLOYMENTS, early_stop=False)
    setup = Setup(robot.nominal, plants, robot.reference, learning, case.control, case.number, known, robot.priors)
    with tempfile.TemporaryDirectory() as folder:
        run_experiment(setup, Path(folder), Observer(on_step=log.append))
    return [Steps(robot.nominal.space, log).of_iteration(k) for k in range(REDEPLOYMENTS + 1)]


def compared(learned: Steps, without: Steps, steps: int, left_out: Collection[int]) -> dict[str, Any]:
    """A deployment with learning, beside that without.

    Args:
        learned: Steps of the one.
        without: Steps of the other.
        steps: Number of targets.
        left_out: Numbers of steps that were measured wrongly, whose errors do not count.
    """
    errors = squared_errors(learned), squared_errors(without)
    counted = np.array([k for k in range(min(map(len, errors))) if k + 1 not in left_out], int)
    with_learning, alone = errors[0][counted], errors[1][counted]
    found = {
        "steps": len(errors[0]),
        "fell": len(errors[0]) < steps,
        "fell_without": len(errors[1]) < steps,
        "rmse": float(np.sqrt(np.mean(with_learning))) if len(counted) else None,
        "rmse_without": float(np.sqrt(np.mean(alone))) if len(counted) else None,
    }
    return found | {"worse": is_worse(with_learning, alone)}


def is_worse(squares: Array, without: Array) -> bool:
    """Whether the squared errors of a deployment are larger by more than noise."""
    length = max(1, round(len(squares) ** (1 / 3)))
    blocks = (squares - without)[: len(squares) // length * length].reshape(-1, length).mean(axis=1)
    if len(blocks) < 3:
        return False
    error = blocks.std(ddof=1) / np.sqrt(len(blocks))
    return bool(blocks.mean() > STANDARD_ERRORS * error and squares.mean() > RATIO**2 * without.mean())


def measure(case: Case, methods: Sequence[str]) -> Row:
    """The row of a case."""
    begin, make = process_time(), robots(case.policy)[case.robot]
    robot, row = make(case.number), {"robot": case.robot, "case": case.number, "planted": case.planted}
    known = None
    try:
        if case.planted == "warm start":
            source = WRONG[case.number // len(PLANTED) % len(WRONG)]
            row["source"], known = source, known_steps(source, make, case.number, lambda reference: reference)
        without = run(robot, case, UNCORRECTED, None)
        deployments = list[dict[str, Any]]()
        for method in methods:
            for k, steps in enumerate(run(robot, case, METHODS[method], known)):
                if k or method == "online" or known:
                    left_out = wrong_measurements(robot, case, k)
                    found = compared(steps, without[k], len(robot.reference), left_out)
                    deployments.append({"method": method, "deployment": k} | found)
    except RigFault as fault:
        return row | {"fault": str(fault), "deployments": [], "seconds": process_time() - begin}
    return row | {"deployments": deployments, "seconds": process_time() - begin}


def extra_bound(extra: int, of: int) -> float:
    """Upper bound of a rate, one-sided 97.5 %, by Clopper and Pearson."""
    return float(beta.ppf(0.975, extra + 1, of - extra)) if extra < of else 1.0


def print_line(label: str, deployments: Sequence[Row]) -> None:
    """Prints the counts of some deployments."""
    falls, alone = (np.array([each[key] for each in deployments], bool) for key in ("fell", "fell_without"))
    extra, worse, number = int(np.sum(falls & ~alone)), sum(each["worse"] for each in deployments), len(deployments)
    rmse = [each["rmse"] / each["rmse_without"] for each in deployments if each["rmse_without"]]
    print(
        f"{label:32}{number:6}{falls.sum():7}{alone.sum():8}{int(falls.sum()) - int(alone.sum()):+7}"
        f"{100 * extra_bound(extra, number):8.2f} %{worse:7} ({100 * worse / number:5.1f} %)"
        f"{np.sum(np.array(rmse) > RATIO):8}{np.median(rmse):9.2f}{np.quantile(rmse, 0.9):7.2f}"
    )


def print_tables(rows: Sequence[Row]) -> None:
    """Prints a line for each robot and planted change, and totals."""
    header = "falls without  extra    bound  worse than noise   > 1.1   median    p90"
    print(f"{'':32}{'number':>6}  {header} of the ratio of errors")
    all_of = [({**row, "deployments": 0} | each) for row in rows for each in row["deployments"]]
    groups: list[tuple[str, Callable[[Row], bool]]] = []
    for name, planted in product(dict.fromkeys(row["robot"] for row in rows), PLANTED):
        groups.append((f"{name}, {planted}", lambda row, n=name, p=planted: (row["robot"], row["planted"]) == (n, p)))
    for key in ("robot", "planted", "method", "deployment", "source"):
        for value in dict.fromkeys(row[key] for row in all_of if key in row):
            groups.append((f"all: {key} {value}", lambda row, k=key, v=value: row.get(k) == v))
    for label, chosen in [*groups, ("all", lambda row: True)]:
        if some := [row for row in all_of if chosen(row)]:
            print_line(label, some)
    for name in dict.fromkeys(row["robot"] for row in rows):
        seconds = [row["seconds"] for row in rows if row["robot"] == name]
        faults = sum("fault" in row for row in rows if row["robot"] == name)
        print(f"{name}: {len(seconds)} cases, {np.mean(seconds):.1f} s of CPU each; {faults} did not start")


def main() -> None:
    """Runs the cases that `--out` lacks, and prints the tables of all."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--robots", default="")
    parser.add_argument("--cases", type=int, default=40)
    parser.add_argument("--first-seed", type=int, default=1000)
    parser.add_argument("--policy", type=Path)
    parser.add_argument("--methods", default=",".join(METHODS))
    parser.add_argument("--largest-change", type=float, default=1.0, help="control.largest_change, of both runs")
    given = parser.parse_args()
    names = given.robots.split(",") if given.robots else list(robots(given.policy))
    rows: list[Row] = [json.loads(line) for line in given.out.open()] if given.out.exists() else []
    done = {(row["robot"], row["case"]) for row in rows}
    numbers = range(given.first_seed, given.first_seed + given.cases)
    control = ControlSettings(largest_change=given.largest_change)
    cases = [Case(name, number, given.policy, control) for number, name in product(numbers, names)]
    waiting = [case for case in cases if case[:2] not in done]
    with given.out.open("a", encoding="utf-8") as out:
        for _, row in finished(partial(measure, methods=given.methods.split(",")), waiting):
            rows.append(row)
            print(json.dumps(row), file=out, flush=True)
    print_tables(sorted(rows, key=lambda row: (row["robot"], row["case"])))


if __name__ == "__main__":
    main()

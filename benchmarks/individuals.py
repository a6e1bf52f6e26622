"""Ten robots of one type, two of them with a planted fault: whom `stepgap compare` names, and how often without one.

    ./go python -m benchmarks.individuals [--sets 20] [--slow 0.08] [--residual posterior] [--out FOLDER]

Robots are `Stroller`s of one kind whose matrix differs by 2 % and whose offset by 8 mm/s and mrad/s (standard
deviations). Planted are a robot that walks slower by `--slow` [m/s], and one that turns a fifth too little. Each made
160 steps with targets of its own. With `--out`, the model files of the first set are written there, for `stepgap
compare FOLDER/*.json`.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from benchmarks.velocity_robots import STROLLER_SPACE, Stroller, VelocityPlant, as_commanded
from stepgap.base.random_streams import random_stream
from stepgap.control.settings import ControlSettings
from stepgap.export.controller.model_document import model_text
from stepgap.export.controller.portable_controller import PortableController
from stepgap.learning.learner import Learner
from stepgap.learning.observations import observe
from stepgap.learning.settings import LearningSettings
from stepgap.learning.steps import LoggedStep, Steps
from stepgap.study.individuals import ComparedRobots, Individual, compare_individuals, difference_sentences

ROBOTS, STEPS, HELD = 10, 160, 8
SLOW, TURNS_LITTLE = 3, 7


class Sibling(Stroller):
    """A stroller of the kind of a set.

    Args:
        kind: Number of the set.
        number: Number of the robot in it.
        fault: By what it is too slow [m/s], 0 if it turns too little; None if nothing is wrong.
    """

    def __init__(self, kind: int, number: int, fault: float | None):
        super().__init__(random_stream(kind, 1000))
        rng = random_stream(kind, number)
        self._matrix = self._matrix * (1 + 0.02 * rng.normal(size=(3, 3)))
        self._offset = self._offset + 0.008 * rng.normal(size=3)
        if fault:
            self._offset = self._offset - np.array([fault, 0.0, 0.0])
        elif fault is not None:
            self._matrix = self._matrix * np.array([[1.0], [1.0], [0.8]])


def learned(kind: int, number: int, fault: float | None, residual: str) -> Learner:
    """What is known of a robot after steps with the target as command, and random changes of it."""
    space, rng = STROLLER_SPACE, random_stream(kind, number, 7)
    plant, logged, target = VelocityPlant(space, Sibling(kind, number, fault), rng), list[LoggedStep](), np.zeros(3)
    plant.start()
    for step in range(STEPS):
        if step % HELD == 0:
            target = space.state_centre + space.state_scale * rng.uniform(-0.9, 0.9, 3)
        record = plant.take_step(target + 0.1 * space.command_scale * rng.normal(size=3))
        logged.append(LoggedStep(0, step, target, target, np.zeros(3), record))
    return Learner.start(as_commanded(space), Steps(space, logged), LearningSettings(residual), 1)


def compared(learners: Sequence[Learner]) -> ComparedRobots:
    """The comparison of robots that are known as well as that."""
    robots = [Individual(f"robot {k}", each.nominal, each.learned) for k, each in enumerate(learners)]
    return compare_individuals(robots)


def named(comparison: ComparedRobots) -> str:
    """Whom the comparison names, and in what."""
    if not comparison.unlike.any():
        return "nobody"
    return "; ".join(difference_sentences(comparison))


def write_models(learners: Sequence[Learner], folder: Path) -> None:
    """Writes their model files into a new folder."""
    folder.mkdir()
    for number, each in enumerate(learners):
        passport, steps = {"robot": "stroller", "name": f"robot {number}"}, observe(each.known, each.nominal)
        parts = each.nominal, each.residual, each.beliefs, each.failures, ControlSettings()
        controller = PortableController(*parts, steps=steps, passport=passport)
        (folder / f"robot_{number}.json").write_text(model_text(controller), "utf-8")


def main() -> None:
    """Prints a line for each set, and how often whom was named."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sets", type=int, default=20)
    parser.add_argument("--slow", type=float, default=0.08)
    parser.add_argument("--residual", default="posterior")
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    faults = {SLOW: options.slow, TURNS_LITTLE: 0.0}
    false_alarms, found, wrong = 0, dict.fromkeys(faults, 0), 0
    with threadpool_limits(limits=1, user_api="blas"):
        for kind in range(options.sets):
            alike = [learned(kind, number, None, options.residual) for number in range(ROBOTS)]
            mixed = list(alike)
            for number, fault in faults.items():
                mixed[number] = learned(kind, number, fault, options.residual)
            if options.out and not kind:
                write_models(mixed, options.out)
            plain, planted = compared(alike), compared(mixed)
            false_alarms += bool(plain.unlike.any())
            rows = set(np.flatnonzero(planted.unlike.any(axis=1)).tolist())
            wrong += bool(rows - faults.keys())
            found = {number: count + (number in rows) for number, count in found.items()}
            print(f"set {kind}: without a fault {named(plain)}; with two faults {named(planted)}", flush=True)
    print(
        f"{options.sets} sets: false alarms in {false_alarms}; the slow robot is named in {found[SLOW]}, the one that "
        f"turns little in {found[TURNS_LITTLE]}, another one beside them in {wrong}"
    )


if __name__ == "__main__":
    main()

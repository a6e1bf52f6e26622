"""How long the choice of a command takes: one, two and three steps of horizon, two to twelve commands, in C and Python.

    ./go python benchmarks/plan_times.py [--plans 300]

It needs gcc. As many states as commands; a linear nominal map, and what the default learner believes of its error after
200 random steps. States and targets are random in the ranges of use, so some targets are not reached in a step; C and
Python plan the same ones. Times are those of the processor, so other programs do not count.
"""

import argparse
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from time import thread_time

import numpy as np
from c_controller import compiled, started
from threadpoolctl import threadpool_limits

from stepgap.control.settings import ControlSettings
from stepgap.export.controller.portable_controller import PortableController
from stepgap.learning.learner import Learner
from stepgap.learning.settings import LearningSettings
from stepgap.learning.steps import Steps
from stepgap.robots.nominal_maps.affine_map import AffineMap
from stepgap.step import Array, Quantity, StepSpace

SIZES, HORIZONS = (2, 6, 12), (1, 2, 3)
LEARNED = 200
"""Number of steps that are learned."""
REACH = 0.7
"""Effect of a command's half range on its state [half ranges]."""


def controller_of(size: int) -> PortableController:
    """A controller of a robot with this number of states and commands, from random numbers."""
    rng = np.random.default_rng(size)
    state = tuple(Quantity(f"s{i}", "m", -1.0, 1.0) for i in range(size))
    space = StepSpace(state, tuple(Quantity(f"c{i}", "N", -1.0, 1.0) for i in range(size)))
    by_state, by_command = 0.7 * np.eye(size), REACH * np.eye(size)
    by_state, by_command = (
        each + 0.1 * rng.normal(size=(size, size)) / np.sqrt(size) for each in (by_state, by_command)
    )
    zero = np.zeros(size)
    nominal = AffineMap(space, zero, zero, zero, np.hstack([by_state, by_command]))
    states, commands = np.split(rng.uniform(-1, 1, (LEARNED, 2 * size)), 2, axis=1)
    waves = 2 * np.hstack([states, commands]) @ rng.normal(size=(2 * size, size)) / np.sqrt(size)
    after = nominal(states, commands) + 0.1 * np.sin(waves) + 0.03 * rng.normal(size=(LEARNED, size))
    columns = {"state": states, "command": commands, "next_state": after, "predicted": nominal(states, commands)}
    learner = Learner.start(nominal, Steps.of_columns(space, **columns), LearningSettings(), 1)
    return PortableController(nominal, learner.residual, learner.beliefs, learner.failures, ControlSettings())


def times_of(controller: PortableController, folder: Path, plans: int) -> tuple[Array, int]:
    """Processor times of the plans in C and in Python (2, plans) [ms], and how many are equal."""
    code, rng, size = compiled(controller, folder), np.random.default_rng(1), len(controller.space.state)
    filter_ = started(code)
    horizon, seconds, same, command = controller.settings.horizon, np.zeros((2, plans)), 0, code.array(np.zeros(size))
    for number in range(plans):
        state, guess = rng.uniform(-0.5, 0.5, (2, size))
        targets = rng.uniform(-0.5, 0.5, (horizon, size))
        given = code.array(state), code.array(targets), horizon, code.array(guess)
        begin = thread_time()
        code.call("plan_ahead", filter_, *given, np.nan, command, None, None)
        middle = thread_time()
        plan = controller.controller(state, targets[0], guess, targets[1:])
        seconds[:, number] = middle - begin, thread_time() - middle
        same += bool(np.abs(command - plan.command).max() < 1e-6)
    return 1e3 * seconds, same


def main() -> None:
    """Prints a row of the table for each number of commands and horizon."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--plans", type=int, default=300)
    plans = parser.parse_args().plans
    print("commands, horizon: C p50, p99 [ms]; Python p50, p99 [ms]; equal commands; object, stack [kB]")
    with threadpool_limits(limits=1, user_api="blas"):
        for size in SIZES:
            controller = controller_of(size)
            for horizon in HORIZONS:
                with TemporaryDirectory() as folder:
                    planned = replace(controller, settings=ControlSettings(horizon=horizon))
                    found, same = times_of(planned, Path(folder), plans)
                    code = compiled(planned, Path(folder))
                parts = [f"{np.median(each):.3g}, {np.quantile(each, 0.99):.3g}" for each in found]
                sizes = f"{code.size / 1000:.0f}, {code.stack / 1000:.0f}"
                print(f"{size}, {horizon}: {'; '.join(parts)}; {same} of {plans}; {sizes}", flush=True)


if __name__ == "__main__":
    main()

"""The exported C controller beside Python: differences, plans, time, stack and size; and the twin hopped by it.

    ./go stepgap run --seed 5 --iterations 1 --out RUN
    ./go python benchmarks/c_controller.py RUN [--points 10000] [--plans 2000] [--seeds 31,32,33]

It needs a C compiler. Plans are compared with those of `CautiousController` on the portable map, and so are the twin's
deployments: each seed is hopped once with plans in Python and once with plans in C, with the same noise.
"""

import argparse
import ctypes
import re
import subprocess
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter
from typing import Any, Literal

import numpy as np
from scipy.stats import t
from threadpoolctl import threadpool_limits

import stepgap
from stepgap.base.random_streams import random_stream
from stepgap.control.reference import paper_reference
from stepgap.experiment.portable.c_source import Real, c_source
from stepgap.experiment.portable.portable_controller import PortableController, portable_controller
from stepgap.learning.disturbance import DisturbanceFilter
from stepgap.learning.residual import join_points
from stepgap.robots.hopper.robot import Hopper
from stepgap.robots.hopper.simulation import TwinSimulation
from stepgap.step import StepStatus

STRICT = ("-std=c99", "-ffreestanding", "-Wall", "-Wextra", "-Werror", "-Wpedantic", "-O2")


@dataclass(frozen=True)
class Code:
    """A compiled controller; its arrays are those of the type `number`."""

    library: Any
    number: Any
    size: int
    stack: int

    def call(self, name: str, *arguments: Any) -> int:
        """Calls a function of the controller with arrays, numbers or None."""
        scalar = ctypes.c_double if self.number is np.float64 else ctypes.c_float
        passed = [
            each.ctypes.data_as(ctypes.c_void_p)
            if isinstance(each, np.ndarray)
            else scalar(each)
            if isinstance(each, float)
            else each
            for each in arguments
        ]
        return int(getattr(self.library, f"controller_{name}")(*passed))

    def array(self, values: Any) -> Any:
        """A contiguous array of the controller's type."""
        return np.ascontiguousarray(values, self.number)


def compiled(controller: PortableController, folder: Path, real: Real) -> Code:
    """Compiles a controller strictly."""
    source = c_source(controller, "controller", real)
    (folder / "controller.c").write_text(source.code)
    (folder / "controller.h").write_text(source.header)
    subprocess.run(["cc", *STRICT, "-fstack-usage", "-c", "controller.c", "-o", "controller.o"], cwd=folder, check=True)
    sizes = subprocess.run(["size", "controller.o"], cwd=folder, check=True, capture_output=True, text=True).stdout
    stack = [int(row.split("\t")[1]) for row in next(folder.glob("*.su")).read_text().splitlines()]
    subprocess.run(["cc", *STRICT, "-fPIC", "-shared", "controller.c", "-o", f"{real}.so"], cwd=folder, check=True)
    number = np.float64 if real == "double" else np.float32
    return Code(ctypes.CDLL(str(folder / f"{real}.so")), number, int(sizes.split("\n")[1].split()[3]), max(stack))


def compare_map(code: Code, controller: PortableController, count: int, rng: np.random.Generator) -> str:
    """Largest differences of mean and standard deviation [half ranges], also at states far outside the ranges."""
    space, n = controller.space, len(controller.space.state)
    states = space.state_centre + space.state_scale * rng.uniform(-2, 2, (count, n))
    commands = space.command_at(rng.uniform(-1, 1, (count, len(space.command))))
    outcome, std = controller.map.evaluate(states, commands), controller.map.std(states, commands)
    mean, spread, differ, worst = code.array(np.zeros(n)), code.array(np.zeros(n)), 0, np.zeros(2)
    for row in range(count):
        status = code.call("map", code.array(states[row]), code.array(commands[row]), mean, spread)
        differ += status != outcome.status[row]
        if status == StepStatus.OK == outcome.status[row]:
            errors = [np.abs(mean - outcome.next_state[row]), np.abs(spread - std[row])]
            worst = np.maximum(worst, [float((each / space.state_scale).max()) for each in errors])
    return f"map at {count} points: mean within {worst[0]:.1g}, std within {worst[1]:.1g}, other status at {differ}"


def compare_plans(code: Code, controller: PortableController, count: int, rng: np.random.Generator) -> str:
    """How often plans agree, how their expected squared distances compare, and the times of both."""
    space, n, m = controller.space, len(controller.space.state), len(controller.space.command)
    tolerance = 1e-9 if code.number is np.float64 else 1e-4
    same, worse, seconds = 0, 0.0, [[], []]
    command, predicted, std = (code.array(np.zeros(size)) for size in (m, n, n))
    for _ in range(count):
        state, target = space.state_centre + space.state_scale * rng.uniform(-1, 1, (2, n))
        guess = space.command_at(rng.uniform(-1, 1, m))
        given = [code.array(each) for each in (state, target, guess)]
        begin = perf_counter()
        status = code.call("plan", None, *given, 0.0, command, predicted, std)
        middle = perf_counter()
        plan = controller.controller(state, target, guess)
        for times, duration in zip(seconds, (middle - begin, perf_counter() - middle), strict=True):
            times.append(duration)
        assert status == StepStatus.OK
        same += bool(np.abs((command - plan.command) / space.command_scale).max() <= tolerance)
        pairs = ((predicted, std), (plan.predicted, plan.std))
        costs = [np.sum(((mean - target) ** 2 + each**2) / space.state_scale**2) for mean, each in pairs]
        worse = max(worse, float(costs[0] / costs[1] - 1))
    times = [f"median {1e3 * np.median(each):.2g} ms, longest {1e3 * max(each):.2g} ms" for each in seconds]
    return (
        f"{count} plans: {same} equal to {tolerance:g}, expected squared distance at most {worse:.1g} larger; "
        f"C {times[0]}; Python {times[1]}"
    )


def hopped(controller: PortableController, code: Code | None, seed: int) -> float:
    """Tracking error of a deployment on the twin [half ranges], with plans in C, or in Python without `code`."""
    simulation, space = TwinSimulation(Hopper(), random_stream(seed)), controller.space
    reference, command, yaw, errors = paper_reference(), space.command_centre, float("nan"), []
    drift, buffer = DisturbanceFilter.initial(len(space.state)), ctypes.create_string_buffer(16384)
    if code:
        code.call("filter_init", buffer)
    with closing(simulation.plant(random_stream(seed, 0))) as plant:
        state = plant.start()
        for target in reference.targets:
            if code:
                found = [code.array(np.zeros(size)) for size in (len(space.command), len(target), len(target))]
                code.call("plan", buffer, *map(code.array, (state, target, command)), yaw, *found)
                command = np.array(found[0], float)
            else:
                offset, std = drift.offset(yaw), drift.std(yaw) * controller.map.noise_std
                present = replace(controller.map, offset=offset, offset_std=std)
                command = replace(controller.controller, step_map=present)(state, target, command).command
            record = plant.take_step(command)
            if record.status != StepStatus.OK:
                return float("inf")
            errors.append((record.next_state - target) / space.state_scale)
            if code:
                given = map(code.array, (record.state, record.requested, record.next_state))
                code.call("filter_update", buffer, *given, yaw)
            else:
                error = record.next_state - controller.map.nominal(record.state, record.requested)
                remaining = error - controller.map.residual.mean(join_points(record.state, record.requested))
                drift = drift.updated(remaining, yaw)
            state, yaw = record.next_state, float(record.yaw_after)
    return float(np.sqrt(np.mean(np.square(errors))))


def compare_hops(code: Code, controller: PortableController, seeds: list[int]) -> str:
    """Ratio of the tracking errors, with its 95 % interval."""
    same_rules = replace(controller, monitor=False, reject_outliers=False)
    pairs = np.array([[hopped(same_rules, each, seed) for each in (code, None)] for seed in seeds])
    ratios = np.log(pairs[:, 0] / pairs[:, 1])
    half = t.ppf(0.975, len(seeds) - 1) * ratios.std(ddof=1) / np.sqrt(len(seeds))
    mean, low, high = np.exp([ratios.mean(), ratios.mean() - half, ratios.mean() + half])
    return f"twin, {len(seeds)} deployments: error in C / in Python {mean:.4f} ({low:.4f}–{high:.4f}); {pairs.tolist()}"


def main() -> None:
    """Prints a block for each type of the numbers."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path)
    parser.add_argument("--points", type=int, default=10_000)
    parser.add_argument("--plans", type=int, default=2000)
    parser.add_argument("--seeds", default="31,32,33")
    options = parser.parse_args()
    run = stepgap.load_run(options.run)
    kinds: tuple[Literal["double", "float"], ...] = ("double", "float")
    with threadpool_limits(limits=1, user_api="blas"), TemporaryDirectory() as folder:
        controller = portable_controller(run, 1, random_stream(run.settings.seed, 0, 3))
        for sentence in (*controller.approximations, *controller.notes):
            print(re.sub(r"\s+", " ", str(sentence)))
        for real in kinds:
            code = compiled(replace(controller, monitor=False, reject_outliers=False), Path(folder), real)
            print(f"{real}: object {code.size} bytes, largest stack frame {code.stack} bytes")
            print(f"  {compare_map(code, controller, options.points, random_stream(1))}")
            print(f"  {compare_plans(code, controller, options.plans, random_stream(2))}", flush=True)
            print(f"  {compare_hops(code, controller, [int(seed) for seed in options.seeds.split(',')])}", flush=True)


if __name__ == "__main__":
    main()

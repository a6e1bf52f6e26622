"""The exported C controller beside Python: differences, plans, time, stack and size; and the twin hopped by it.

    ./go stepgap run --seed 5 --iterations 1 --out RUN
    ./go python benchmarks/c_controller.py RUN [--points 10000] [--plans 2000] [--seeds 51,52,…,70]

It needs gcc. Map and plans are compared with those of the portable controller, whose formulas the C file contains. Each
seed of the twin is hopped twice with the same floor and noise: with the plans of a run, in Python with the exact
learned model, and with those of the program `examples/c_controller/main.c`, a process that receives each section as a
line.
"""

import argparse
import ctypes
import re
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter
from typing import Any

import numpy as np
from scipy.stats import t
from threadpoolctl import threadpool_limits

import stepgap
from stepgap.base.random_streams import random_stream
from stepgap.experiment.deployment import deploy
from stepgap.experiment.run import Run
from stepgap.export.controller.c_source import c_source
from stepgap.export.controller.portable_controller import PortableController, portable_controller
from stepgap.robots.hopper.paper import paper_reference
from stepgap.robots.hopper.robot import Hopper
from stepgap.step import Array, StepRecord, StepStatus

MAIN = Path(__file__).parents[1] / "examples" / "c_controller" / "main.c"
STRICT = ("-std=c99", "-Wall", "-Wextra", "-Werror", "-Wpedantic", "-O2")
SIZE = """#include "controller.h"
int controller_size(void);
int controller_size(void) { return (int)sizeof(controller_filter); }
"""


@dataclass(frozen=True)
class Code:
    """A compiled controller.

    Attributes:
        library: The shared library.
        program: The program of `examples/c_controller/main.c` with it.
        size: Size of the object file [bytes].
        stack: Stack of the deepest chain of calls [bytes].
    """

    library: Any
    program: Path
    size: int
    stack: int

    def call(self, name: str, *arguments: Any) -> int:
        """Calls a function of the controller with arrays, numbers or None."""
        passed = [
            each.ctypes.data_as(ctypes.c_void_p)
            if isinstance(each, np.ndarray)
            else ctypes.c_double(each)
            if isinstance(each, float)
            else each
            for each in arguments
        ]
        return int(getattr(self.library, f"controller_{name}")(*passed))

    def array(self, values: Any) -> Any:
        """A contiguous array of doubles."""
        return np.ascontiguousarray(values, float)


def compiled(controller: PortableController, folder: Path) -> Code:
    """Compiles a controller strictly."""
    source = c_source(controller, "controller")
    (folder / "controller.c").write_text(source.code)
    (folder / "controller.h").write_text(source.header)
    (folder / "size.c").write_text(SIZE)

    def run(*command: str) -> str:
        return subprocess.run(command, cwd=folder, check=True, capture_output=True, text=True).stdout

    run("gcc", *STRICT, "-fcallgraph-info=su", "-c", "controller.c", "-o", "controller.o")
    run("gcc", *STRICT, "-fPIC", "-shared", "controller.c", "size.c", "-o", "controller.so", "-lm")
    run("gcc", "-std=c99", "-O2", "-I.", str(MAIN), "controller.c", "-o", "program", "-lm")
    size = int(run("size", "controller.o").split("\n")[1].split()[3])
    stack = deepest_stack(next(folder.glob("*.ci")).read_text())
    return Code(ctypes.CDLL(str(folder / "controller.so")), folder / "program", size, stack)


def deepest_stack(graph: str) -> int:
    """Stack of the deepest chain of calls [bytes] in the call graph of gcc; no function may be recursive."""
    frames = {name: int(size) for name, size in re.findall(r'node: { title: "(.+?)" label: ".+?(\d+) bytes', graph)}
    calls: dict[str, set[str]] = {name: set() for name in frames}
    for caller, called in re.findall(r'edge: { sourcename: "(.+?)" targetname: "(.+?)"', graph):
        calls[caller].add(called)

    def depth(name: str, above: frozenset[str]) -> int:
        assert name not in above, f"{name} is recursive"
        below = [depth(each, above | {name}) for each in calls.get(name, ())]
        return frames.get(name, 0) + max(below, default=0)

    return max(depth(name, frozenset()) for name in frames)


def started(code: Code) -> Any:
    """A filter at the start of a deployment."""
    filter_ = ctypes.create_string_buffer(code.call("size"))
    code.call("filter_init", filter_)
    return filter_


def compare_map(code: Code, controller: PortableController, count: int, rng: np.random.Generator) -> str:
    """Largest differences of mean and standard deviation [half ranges], also at states far outside the ranges."""
    space, n = controller.space, len(controller.space.state)
    states = space.state_centre + space.state_scale * rng.uniform(-2, 2, (count, n))
    commands = space.command_at(rng.uniform(-1, 1, (count, len(space.command))))
    outcome, std = controller.map.evaluate(states, commands), controller.map.std(states, commands)
    filter_ = started(code)
    mean, spread, differ, worst = code.array(np.zeros(n)), code.array(np.zeros(n)), 0, np.zeros(2)
    for row in range(count):
        given = code.array(states[row]), code.array(commands[row]), float("nan")
        status = code.call("map", filter_, *given, mean, spread)
        differ += status != outcome.status[row]
        if status == StepStatus.OK == outcome.status[row]:
            errors = [np.abs(mean - outcome.next_state[row]), np.abs(spread - std[row])]
            worst = np.maximum(worst, [float((each / space.state_scale).max()) for each in errors])
    return f"map at {count} points: mean within {worst[0]:.1g}, std within {worst[1]:.1g}, other status at {differ}"


def compare_plans(code: Code, controller: PortableController, count: int, rng: np.random.Generator) -> str:
    """How often plans agree, how their expected squared distances compare, and the times of both."""
    space, n, m = controller.space, len(controller.space.state), len(controller.space.command)
    tolerance, filter_ = 1e-9, started(code)
    apart, worse, seconds = [], 0.0, [[], []]
    command, predicted, std = (code.array(np.zeros(size)) for size in (m, n, n))
    for _ in range(count):
        state, target = space.state_centre + space.state_scale * rng.uniform(-1, 1, (2, n))
        guess = space.command_at(rng.uniform(-1, 1, m))
        given = [code.array(each) for each in (state, target, guess)]
        begin = perf_counter()
        status = code.call("plan", filter_, *given, float("nan"), command, predicted, std)
        middle = perf_counter()
        plan = controller.controller(state, target, guess)
        for times, duration in zip(seconds, (middle - begin, perf_counter() - middle), strict=True):
            times.append(duration)
        assert status == StepStatus.OK
        apart.append(np.abs((command - plan.command) / space.command_scale).max())
        pairs = ((predicted, std), (plan.predicted, plan.std))
        costs = [np.sum(((mean - target) ** 2 + each**2) / space.state_scale**2) for mean, each in pairs]
        worse = max(worse, float(costs[0] / costs[1] - 1))
    times = [f"median {1e3 * np.median(each):.2g} ms, longest {1e3 * max(each):.2g} ms" for each in seconds]
    return (
        f"{count} plans: {np.sum(np.array(apart) <= tolerance)} equal to {tolerance:g} of a half range, "
        f"99 % to {np.quantile(apart, 0.99):.1g}, all to {max(apart):.1g}, expected squared distance at most "
        f"{worse:.1g} larger; C {times[0]}; Python {times[1]}"
    )


def compare_commands(code: Code, run: Run, seed: int) -> str:
    """Differences of the commands on the steps of one deployment of the twin, which Python hops."""
    plant = Hopper().simulations()["twin"](random_stream(seed)).plant(random_stream(seed, 0))
    filter_, command, phase, apart = started(code), None, float("nan"), []
    ahead = run.needed(run.settings).control.horizon
    for logged in deploy(run.learner(1), plant, paper_reference(), 1, control=run.needed(run.settings).control):
        record, found = logged.record, code.array(np.zeros(len(plant.space.command)))
        targets = paper_reference().targets[logged.step - 1 :][:ahead]
        given = code.array(record.state), code.array(targets), len(targets)
        if logged.planned:
            before = None if command is None else code.array(command)
            code.call("plan_ahead", filter_, *given, before, phase, found, None, None)
            apart.append((found - record.requested) / plant.space.command_scale)
        code.call(
            "filter_update", filter_, *map(code.array, (record.state, record.requested, record.next_state)), phase
        )
        command, phase = record.requested, record.context.get("yaw", float("nan"))
    rms, worst = np.sqrt(np.mean(np.square(apart))), np.abs(apart).max()
    return f"{len(apart)} commands of a deployment: RMS difference {rms:.1g} of a half range, at most {worst:.1g}"


def steps_of(run: Run, seed: int) -> Iterator[StepRecord]:
    """A deployment of the twin with the controller of the run, before deployment 1."""
    plant = Hopper().simulations()["twin"](random_stream(seed)).plant(random_stream(seed, 0))
    for logged in deploy(run.learner(1), plant, paper_reference(), 1, control=run.needed(run.settings).control):
        if logged.planned:
            yield logged.record


def steps_of_program(program: Path, seed: int) -> Iterator[StepRecord]:
    """The same with the program, which receives a line with state, target and phase, and answers with the command."""
    plant = Hopper().simulations()["twin"](random_stream(seed)).plant(random_stream(seed, 0))
    with plant, subprocess.Popen([program], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdin
        assert process.stdout
        state, phase = plant.start(), float("nan")
        for target in paper_reference().targets:
            print(*state.tolist(), *target.tolist(), phase, file=process.stdin, flush=True)
            status, *command = process.stdout.readline().split()
            assert int(status) == StepStatus.OK
            record = plant.take_step(np.array(command, float))
            yield record
            state, phase = record.next_state, record.context.get("yaw", float("nan"))
        process.stdin.close()


def tracking_error(steps: Iterator[StepRecord]) -> Array:
    """RMS error of speed and height [mm/s, mm]."""
    records = list(steps)
    assert all(record.status == StepStatus.OK for record in records)
    errors = np.array([record.next_state for record in records]) - paper_reference().targets
    return 1e3 * np.sqrt(np.mean(np.square(errors), axis=0))


def compare_hops(code: Code, python: Array, seeds: list[int]) -> str:
    """Mean error of both, and their paired difference with its 95 % interval."""
    c = np.array([tracking_error(steps_of_program(code.program, seed)) for seed in seeds])
    half = t.ppf(0.975, len(seeds) - 1) * (c - python).std(axis=0, ddof=1) / np.sqrt(len(seeds))
    rows = zip(("speed", "height"), ("mm/s", "mm"), c.mean(0), python.mean(0), (c - python).mean(0), half, strict=True)
    parts = [
        f"{name} C {a:.3f}, Python {b:.3f} {unit}, C − Python {d:+.3f} ± {h:.3f}" for name, unit, a, b, d, h in rows
    ]
    return f"twin, {len(seeds)} deployments of {len(paper_reference())} steps, RMS error: {'; '.join(parts)}"


def main() -> None:
    """Prints the comparison."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path)
    parser.add_argument("--points", type=int, default=10_000)
    parser.add_argument("--plans", type=int, default=2000)
    parser.add_argument("--seeds", default="51,52,53,54,55,56,57,58,59,60,61,62,63,64,65,66,67,68,69,70")
    options = parser.parse_args()
    run = stepgap.load_run(options.run)
    seeds = [int(seed) for seed in options.seeds.split(",")]
    with threadpool_limits(limits=1, user_api="blas"), TemporaryDirectory() as folder:
        controller = portable_controller(run, 1, random_stream(run.needed(run.settings).seed, 0, 3))
        for sentence in (*controller.approximations, *controller.notes):
            print(re.sub(r"\s+", " ", str(sentence)))
        python = np.array([tracking_error(steps_of(run, seed)) for seed in seeds])
        code = compiled(controller, Path(folder))
        print(f"object {code.size} bytes, stack of the deepest calls {code.stack} bytes, {' '.join(STRICT)}")
        print(compare_map(code, controller, options.points, random_stream(1)))
        print(compare_plans(code, controller, options.plans, random_stream(2)), flush=True)
        print(compare_commands(code, run, seeds[0]))
        print(compare_hops(code, python, seeds))


if __name__ == "__main__":
    main()

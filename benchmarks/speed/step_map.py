"""`benchmarks.speed step-map`: computing times of the nominal map and of everything that is built on it.

Single calls and batches take turns within one run, so that a busy machine slows both equally: compare ratios, not
times.
"""

import os
from collections.abc import Callable
from dataclasses import dataclass
from time import perf_counter
from typing import Any

import numpy as np

from benchmarks.speed.timing import Announce, machine, timed
from stepgap.base.errors import StepGapError
from stepgap.control.command_table import build_table
from stepgap.control.step_controller import StepController
from stepgap.robots.hopper.model.apex_map import ApexMap
from stepgap.step import Array, StepStatus

MAP_PACKAGES = ("stepgap", "numpy", "scipy", "numba")
"""Packages whose versions are part of the result."""

Evaluate = Callable[[Any, Any], Any]
"""Function of state (n,) and command (m,) that returns the next state (n,)."""


class TooFewSteps(StepGapError):
    """Too few steps succeed with the settings to measure anything; the message is one line."""


@dataclass(frozen=True)
class MapBenchSize:
    """Size of the benchmark.

    Attributes:
        points: Number of random points of the timed calls.
        rounds: Number of turns of the engines.
        solves: Number of random reachable pairs of state and target.
        table: Number of points along each axis of the command table.
        batch: Number of maps in a batch.
    """

    points: int
    rounds: int
    solves: int
    table: int
    batch: int


BATCH_ROUNDS = 5

FULL_MAP_BENCH = MapBenchSize(points=50, rounds=15, solves=500, table=15, batch=4000)
QUICK_MAP_BENCH = MapBenchSize(points=3, rounds=3, solves=50, table=4, batch=500)


@dataclass(frozen=True)
class Engine:
    """A way to evaluate the map.

    Attributes:
        name: Name in the table.
        note: How it is called.
        evaluate: Function that computes one step.
        calls: Number of timed calls in a round.
        maps: Number of maps that one call evaluates.
    """

    name: str
    note: str
    evaluate: Evaluate
    calls: int
    maps: int = 1


def bench_map(
    nominal: ApexMap,
    seed: int,
    quick: bool,
    announce: Announce = lambda line: None,
) -> dict[str, Any]:
    """Runs all sections of the benchmark; the result is plain data for JSON.

    Args:
        nominal: StepGap's engine.
        seed: Seed of the random points.
        quick: Whether to use few points.
        announce: Called with the name of each section before it begins.
    """
    size, rng = QUICK_MAP_BENCH if quick else FULL_MAP_BENCH, np.random.default_rng(seed)
    states, commands = random_steps(nominal, rng, size.points)
    announce("engines, taking turns")
    rows = time_engines(_engines(nominal, states, commands), states, commands, size.rounds)
    announce("Jacobian")
    jacobian = _jacobian(nominal)
    announce("root solve")
    solved = _root_solve(nominal, rng, size.solves)
    announce("batch")
    batch = _batch(nominal, rng, size.batch)
    announce(f"command table of {size.table}⁴")
    return {
        "schema": 2,
        "quick": quick,
        "seed": seed,
        "machine": machine(MAP_PACKAGES),
        "engines": rows,
        "jacobian": jacobian,
        "root_solve": solved,
        "batch": batch,
        "table": _table(nominal, size.table),
    }


def random_steps(nominal: ApexMap, rng: np.random.Generator, count: int) -> tuple[Array, Array]:
    """Random states and commands within their ranges that make a step; shapes (count, n) and (count, m).

    Raises:
        TooFewSteps: Fewer than a quarter of the random points make a step.
    """
    space, most = nominal.space, 4 * count
    lower, upper = ([getattr(quantity, end) for quantity in space.state] for end in ("lower", "upper"))
    states = rng.uniform(lower, upper, (most, len(lower)))
    commands = rng.uniform(space.command_lower, space.command_upper, (most, len(space.command)))
    succeed = np.flatnonzero(nominal.evaluate(states, commands).status == StepStatus.OK)[:count]
    if len(succeed) < count:
        raise TooFewSteps(
            f"only {len(succeed)} of {most} random steps succeed; choose settings with which the robot hops"
        )
    return states[succeed], commands[succeed]


def _engines(nominal: ApexMap, states: Array, commands: Array) -> list[Engine]:
    many = np.resize(states, (15, 2)), np.resize(commands, (15, 2))
    return [
        Engine("StepGap", "one call from Python", lambda state, command: nominal(state, command), calls=100),
        Engine("StepGap in a batch", "15 maps per call", lambda *_: nominal.evaluate(*many), 20, maps=15),
    ]


def time_engines(engines: list[Engine], states: Array, commands: Array, rounds: int) -> list[dict[str, Any]]:
    """A row for each engine: median time of one map, and median ratio to the first engine."""
    for engine in engines:
        engine.evaluate(states[0], commands[0])  # compiles the engine
    times = [[_round(engine, states, commands, turn) for engine in engines] for turn in range(rounds)]
    medians = np.array([[np.median(taken) for taken in row] for row in times])
    ratios = np.median(medians / medians[:, :1], axis=0)
    return [
        {
            "name": engine.name,
            "note": engine.note,
            "median_us": 1e6 * float(np.median(np.concatenate([row[k] for row in times]))),
            "ratio": float(ratios[k]),
            "calls": engine.calls * rounds,
        }
        for k, engine in enumerate(engines)
    ]


def _round(engine: Engine, states: Array, commands: Array, turn: int) -> list[float]:
    """Times of one map in the calls of a round [s]."""
    taken = []
    for call in range(engine.calls):
        i = (turn * engine.calls + call) % len(states)
        begin = perf_counter()
        engine.evaluate(states[i], commands[i])
        taken.append((perf_counter() - begin) / engine.maps)
    return taken


def _jacobian(nominal: ApexMap) -> dict[str, Any]:
    """Cost of the Jacobian in maps."""
    many = random_steps(nominal, np.random.default_rng(0), 15)
    pairs = [(timed(lambda: nominal.jacobian(*many)), timed(lambda: nominal.evaluate(*many))) for _ in range(9)]
    return {"maps": float(np.median([jacobian / single for jacobian, single in pairs]))}


def _root_solve(nominal: ApexMap, rng: np.random.Generator, count: int) -> dict[str, Any]:
    """Times of solves without a guess for random pairs of state and reachable target."""
    states, commands = random_steps(nominal, rng, count)
    targets, controller = nominal(states, commands), StepController(nominal)
    times, reached = [], []
    for state, target in zip(states, targets, strict=True):
        begin = perf_counter()
        plan = controller(state, target)
        times.append(perf_counter() - begin)
        reached.append(plan.reached)
    median, p99 = (1e3 * float(np.quantile(times, share)) for share in (0.5, 0.99))
    return {"median_ms": median, "p99_ms": p99, "solved_share": float(np.mean(reached)), "pairs": count}


def _batch(nominal: ApexMap, rng: np.random.Generator, count: int) -> dict[str, Any]:
    """Time per map in a batch, alternately on one core and on all."""
    many = random_steps(nominal, rng, count)
    if not hasattr(os, "sched_setaffinity"):
        return {"cores": os.cpu_count(), "one_core_us": None, "all_cores_us": timed(lambda: nominal.evaluate(*many))}
    cores = os.sched_getaffinity(0)
    one, every = [], []
    for _ in range(BATCH_ROUNDS):
        try:
            os.sched_setaffinity(0, {min(cores)})
            one.append(timed(lambda: nominal.evaluate(*many)))
        finally:
            os.sched_setaffinity(0, cores)
        every.append(timed(lambda: nominal.evaluate(*many)))
    us = [1e6 * float(np.median(taken)) / count for taken in (one, every)]
    speed_up = float(np.median(np.array(one) / every))
    return {"cores": len(cores), "one_core_us": us[0], "all_cores_us": us[1], "speed_up": speed_up}


def _table(nominal: ApexMap, points: int) -> dict[str, Any]:
    """Time to compute a command table."""
    begin = perf_counter()
    table = build_table(nominal, points)
    return {"points": points, "seconds": perf_counter() - begin, "within_reach": float(table.reached.mean())}


def describe_map_bench(result: dict[str, Any]) -> str:
    """The result as a text table and a line for each further section."""
    lines = [f"{'engine':22}{'one map':>12}{'ratio':>10}   note"]
    for row in result["engines"]:
        lines.append(f"{row['name']:22}{row['median_us']:9.1f} µs{row['ratio']:10.2f}   {row['note']}")
    jacobian, solve, batch, table = (result[name] for name in ("jacobian", "root_solve", "batch", "table"))
    lines += [
        "",
        f"Jacobian       {jacobian['maps']:.1f} maps",
        f"root solve     median {solve['median_ms']:.2f} ms, 99 % within {solve['p99_ms']:.2f} ms, "
        f"{solve['solved_share']:.1%} of {solve['pairs']} solved",
    ]
    if batch["one_core_us"] is not None:
        lines.append(
            f"batch          {batch['one_core_us']:.1f} µs per map on one core, {batch['all_cores_us']:.1f} on "
            f"{batch['cores']}: {batch['speed_up']:.2f} times as fast"
        )
    lines.append(
        f"command table  {table['points']}⁴ in {table['seconds']:.1f} s, {table['within_reach']:.0%} within reach"
    )
    return "\n".join(lines)

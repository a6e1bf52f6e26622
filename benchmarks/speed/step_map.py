"""`benchmarks.speed map`: computing times of the nominal map and of everything that is built on it.

Other engines can be measured with it, as in `benchmarks/compare_maps.py`. Engines take turns within one run, so that a
busy machine slows all of them equally: compare ratios, not times.
"""

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from time import perf_counter
from typing import Any

import numpy as np

from benchmarks.speed.timing import Announce, machine, timed
from stepgap.base.errors import StepGapError
from stepgap.control.command_table import build_table
from stepgap.control.step_controller import StepController
from stepgap.robots.hopper.model.apex_map import ApexMap
from stepgap.step import Array, StepStatus

MAP_PACKAGES = ("stepgap", "numpy", "scipy", "numba", "mujoco", "heyoka")
"""Packages whose versions are part of the result."""

Evaluate = Callable[[Any, Any], Any]
"""Function of state (n,) and command (m,) that returns the next state (n,)."""


class TooFewSteps(StepGapError):
    """Too few steps succeed with the settings to measure anything; the message is one line."""


@dataclass(frozen=True)
class MapBenchSize:
    """Size of the benchmark.

    Attributes:
        points: Number of random points at which the errors of all engines are measured.
        rounds: Number of turns of the engines.
        jacobians: Number of points at which the Jacobian is compared with differences of the reference.
        solves: Number of random reachable pairs of state and target.
        table: Number of points along each axis of the command table.
        batch: Number of maps in a batch.
    """

    points: int
    rounds: int
    jacobians: int
    solves: int
    table: int
    batch: int


BATCH_ROUNDS = 5

FULL_MAP_BENCH = MapBenchSize(points=50, rounds=15, jacobians=10, solves=500, table=15, batch=4000)
QUICK_MAP_BENCH = MapBenchSize(points=3, rounds=3, jacobians=0, solves=50, table=4, batch=500)


@dataclass(frozen=True)
class Engine:
    """An implementation of the map.

    Attributes:
        name: Name in the table.
        note: Method and tolerance.
        evaluate: Function that computes one step.
        calls: Number of timed calls in a round.
        maps: Number of maps that one call evaluates.
        error: Error of the engine, if it cannot be measured by calls.
    """

    name: str
    note: str
    evaluate: Evaluate
    calls: int
    maps: int = 1
    error: float | None = None


@dataclass(frozen=True)
class MapPeers:
    """Other implementations of the same map.

    Attributes:
        engines: Engines that are available.
        skipped: Names of the others, with the reason why each is left out.
        reference: The map with a much smaller tolerance, relative to which errors are measured.
    """

    engines: Sequence[Engine] = ()
    skipped: Mapping[str, str] = field(default_factory=dict)
    reference: Evaluate | None = None


NO_PEERS = MapPeers()


def bench_map(
    nominal: ApexMap,
    seed: int,
    quick: bool,
    announce: Announce = lambda line: None,
    peers: MapPeers = NO_PEERS,
) -> dict[str, Any]:
    """Runs all sections of the benchmark; the result is plain data for JSON.

    Args:
        nominal: StepGap's engine.
        seed: Seed of the random points.
        quick: Whether to use few points.
        announce: Called with the name of each section before it begins.
        peers: Other engines to measure.
    """
    size, rng = QUICK_MAP_BENCH if quick else FULL_MAP_BENCH, np.random.default_rng(seed)
    states, commands = random_steps(nominal, rng, size.points)
    announce("engines, taking turns")
    truth = None if peers.reference is None else _evaluate_all(peers.reference, states, commands)
    engines = [*_ours(nominal, states, commands), *peers.engines]
    rows = time_engines(engines, states, commands, truth, nominal, size.rounds)
    announce("Jacobian")
    jacobian = _jacobian(nominal, peers.reference, states[: size.jacobians], commands[: size.jacobians])
    announce("root solve")
    solved = _root_solve(nominal, rng, size.solves)
    announce("batch")
    batch = _batch(nominal, rng, size.batch)
    announce(f"command table of {size.table}⁴")
    return {
        "schema": 1,
        "quick": quick,
        "seed": seed,
        "machine": machine(MAP_PACKAGES),
        "engines": rows,
        "skipped": dict(peers.skipped),
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


def _ours(nominal: ApexMap, states: Array, commands: Array) -> list[Engine]:
    many = np.resize(states, (15, 2)), np.resize(commands, (15, 2))
    return [
        Engine("StepGap", "one call from Python", lambda state, command: nominal(state, command), calls=100),
        Engine("StepGap in a batch", "15 maps per call", lambda *_: nominal.evaluate(*many), 20, maps=15, error=0.0),
    ]


def time_engines(
    engines: list[Engine], states: Array, commands: Array, truth: Array | None, nominal: ApexMap, rounds: int
) -> list[dict[str, Any]]:
    """A row for each engine: median time of one map, median ratio to the first engine, and error."""
    for engine in engines:
        engine.evaluate(states[0], commands[0])  # compiles the engine
    times = [[_round(engine, states, commands, turn) for engine in engines] for turn in range(rounds)]
    medians = np.array([[np.median(taken) for taken in row] for row in times])
    ratios = np.median(medians / medians[:, :1], axis=0)
    rows: list[dict[str, Any]] = []
    for k, engine in enumerate(engines):
        error = engine.error
        if engine.maps > 1:
            error = rows[0]["largest_relative_error"]  # the same engine
        elif error is None and truth is not None:
            error = _largest_error(nominal, engine.evaluate, states, commands, truth)
        rows.append(
            {
                "name": engine.name,
                "note": engine.note,
                "median_us": 1e6 * float(np.median(np.concatenate([row[k] for row in times]))),
                "ratio": float(ratios[k]),
                "largest_relative_error": error,
                "calls": engine.calls * rounds,
            }
        )
    return rows


def _round(engine: Engine, states: Array, commands: Array, turn: int) -> list[float]:
    """Times of one map in the calls of a round [s]."""
    taken = []
    for call in range(engine.calls):
        i = (turn * engine.calls + call) % len(states)
        begin = perf_counter()
        engine.evaluate(states[i], commands[i])
        taken.append((perf_counter() - begin) / engine.maps)
    return taken


def _evaluate_all(evaluate: Evaluate, states: Array, commands: Array) -> Array:
    """Next states of many steps, one after another; shape (N, n)."""
    return np.array([evaluate(state, command) for state, command in zip(states, commands, strict=True)])


def _largest_error(nominal: ApexMap, evaluate: Evaluate, states: Array, commands: Array, truth: Array) -> float:
    """Largest error relative to the larger of the true value and half the range."""
    found = _evaluate_all(evaluate, states, commands)
    return float((np.abs(found - truth) / np.maximum(np.abs(truth), nominal.space.state_scale)).max())


def _jacobian(nominal: ApexMap, reference: Evaluate | None, states: Array, commands: Array) -> dict[str, Any]:
    """Cost of the Jacobian in maps, and its largest error relative to its largest entry, by Richardson differences."""
    many = random_steps(nominal, np.random.default_rng(0), 15)
    pairs = [(timed(lambda: nominal.jacobian(*many)), timed(lambda: nominal.evaluate(*many))) for _ in range(9)]
    errors = []
    for state, command in zip(states, commands, strict=True):
        if reference is not None:
            exact = richardson(nominal, reference, state, command)
            errors.append(float(np.abs(nominal.jacobian(state, command) - exact).max() / np.abs(exact).max()))
    cost = float(np.median([jacobian / single for jacobian, single in pairs]))
    return {"maps": cost, "largest_error": max(errors, default=None), "points": len(errors)}


def richardson(nominal: ApexMap, evaluate: Evaluate, state: Array, command: Array) -> Array:
    """∂next/∂(state, command) by Richardson extrapolation of central differences; shape (n, n + m)."""
    point, n = np.concatenate([state, command]), len(state)
    scale = np.concatenate([nominal.space.state_scale, nominal.space.command_scale])
    columns = []
    for index, width in enumerate(1e-2 * scale):
        wide, narrow = (
            (evaluate(*np.split(point + offset, [n])) - evaluate(*np.split(point - offset, [n]))) / (2 * h)
            for h in (width, width / 2)
            for offset in [h * np.eye(len(point))[index]]
        )
        columns.append((4 * narrow - wide) / 3)
    return np.stack(columns, axis=-1)


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
    lines = [f"{'engine':22}{'one map':>12}{'ratio':>10}{'error':>10}   note"]
    for row in result["engines"]:
        error = row["largest_relative_error"]
        text = "-" if error is None else f"{error:.1e}"
        lines.append(f"{row['name']:22}{row['median_us']:9.1f} µs{row['ratio']:10.2f}{text:>10}   {row['note']}")
    lines += [f"{name:22}{'skipped':>12}{'':20}   {reason}" for name, reason in result["skipped"].items()]
    jacobian, solve, batch, table = (result[name] for name in ("jacobian", "root_solve", "batch", "table"))
    largest = jacobian["largest_error"]
    error = "" if largest is None else f", largest error {largest:.1e} of its largest entry"
    lines += [
        "",
        f"Jacobian       {jacobian['maps']:.1f} maps{error}",
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

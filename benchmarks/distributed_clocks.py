"""Ticks on distributed clocks: two drives that need SYNC0, clocks that drift, and a master that follows them.

    ./go python -m benchmarks.distributed_clocks --ticks 1000000

The ring runs in lock-step over a veth pair, with SOEM as its master. Its time is computed, not measured: a tick begins
after a delay with an exponential distribution, and a rare one much later. `--frames 4` sends four frames per tick, and
`--tick 0.00025` controls at 4 kHz.
"""

import os
from argparse import ArgumentParser
from time import perf_counter

import numpy as np

from stepgap.hardware.ethercat.emulator.faults import Fault
from stepgap.rigs.rig import RigFault
from tests.hardware.ethercat.computed_time import TICK, TimedRig, drifting_clocks, settings_with_sync0, timed_rig

COMPARED_EVERY = 100
"""Number of ticks between two comparisons of the drives' clocks."""

SETTLED = 1000
"""Number of ticks after which the start is over."""


def delays(rng: np.random.Generator, ticks: int, jitter: float, outlier: float, outliers: float) -> list[float]:
    """Delays of ticks [s]."""
    rare = rng.random(ticks) < outliers
    return (rng.exponential(jitter, ticks) + rare * rng.uniform(0, outlier, ticks)).tolist()


def drive(timed: TimedRig, late: list[float]) -> tuple[list[float], list[int], str]:
    """Runs ticks; returns the offsets of their frames [s], the distances of the drives' clocks [ns], and the fault."""
    offsets, apart = [], []
    try:
        for tick, delay in enumerate(late):
            offsets += timed.tick(delay)
            if tick % COMPARED_EVERY == COMPARED_EVERY - 1:
                apart.append(timed.apart())
    except RigFault as fault:
        return offsets, apart, str(fault)
    return offsets, apart, ""


def run(
    ticks: int,
    seed: int,
    jitter: float,
    outlier: float,
    outliers: float,
    lost: int,
    tick: float,
    frames: int,
) -> None:
    """Runs the benchmark and prints its result."""
    rng = np.random.default_rng(seed)
    clocks, late = drifting_clocks(rng), delays(rng, ticks, jitter, outlier, outliers)
    cycles = np.linspace(2000, ticks * frames, lost, endpoint=False)
    faults, interface = tuple(Fault("lost frames", int(cycle), cycles=2) for cycle in cycles), f"dc{os.getpid()}"
    began = perf_counter()
    with timed_rig(interface, clocks, faults, settings_with_sync0(interface, tick, frames)) as timed:
        offsets, apart, fault = drive(timed, late)
    print(f"{len(offsets)} frames in {perf_counter() - began:.0f} s, {lost} times two frames lost")
    print(f"fault: {fault or 'none'}")
    first = SETTLED * frames
    for name, values, skipped in (
        ("frame from its time", 1e6 * np.abs(offsets), first),
        ("jitter, from frame to frame", 1e6 * np.abs(np.diff(offsets)), first),
        ("clocks apart", 1e-3 * np.abs(apart), SETTLED // COMPARED_EVERY),
    ):
        settled = values[skipped:]
        quantiles = ", ".join(f"{100 * q:g} % {np.quantile(settled, q):.2f} µs" for q in (0.5, 0.99, 0.999))
        print(f"{name}: {quantiles}, worst {settled.max():.2f} µs; in the first {SETTLED} ticks {values.max():.2f} µs")


if __name__ == "__main__":
    parser = ArgumentParser(description=__doc__)
    parser.add_argument("--ticks", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jitter", type=float, default=5e-6, help="mean delay of a tick [s]")
    parser.add_argument("--outlier", type=float, default=2e-4, help="largest additional delay of a rare tick [s]")
    parser.add_argument("--outliers", type=float, default=1e-3, help="share of such ticks")
    parser.add_argument("--lost", type=int, default=0, help="number of times two frames are lost")
    parser.add_argument("--tick", type=float, default=TICK, help="time between two ticks [s]")
    parser.add_argument("--frames", type=int, default=1, help="frames per tick")
    run(**vars(parser.parse_args()))

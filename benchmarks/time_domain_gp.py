"""Cost of learning the error in the time domain, compared with one point per step, on the same hops of the twin.

A Gaussian process in the time domain gets a point per sample of a hop (leg, hip, torques → change of the vertical speed
until the next sample); StepGap's gets a point per hop (state, command → error of the next state). Both have one output
and are fitted by the same code on one thread. A fit to many points needs some dozen factorisations, each ∝ N³; a row
marked * is extrapolated accordingly from the largest measured fit.

    ./go python benchmarks/time_domain_gp.py --hops 4
"""

import argparse
from time import perf_counter

import numpy as np
from threadpoolctl import threadpool_limits

from stepgap.control.step_controller import StepController
from stepgap.gauss.gaussian_process_fit import fit_gaussian_process
from stepgap.plants.compiled_rig import Rows
from stepgap.plants.rig_plant import RigPlant
from stepgap.robots.hopper import CommandBounds, Gains, RobotParameters
from stepgap.robots.hopper.model.apex_map import ApexMap
from stepgap.robots.hopper.tick.hop_control import HopperControl
from stepgap.robots.hopper.tick.tick_row import Tick
from stepgap.robots.hopper.twin.reality_gap import RealityGap
from stepgap.robots.hopper.twin.twin import Twin
from stepgap.step import Array

PAPER_STEPS = 227
RATES = (1000, 200, 20)
"""Samples per second; the works cited in the paper sample at 20 to 200 Hz, joints are controlled at 1,000 Hz."""


def record(steps: int, trajectory_hops: int, seed: int) -> tuple[Array, Array, Array]:
    """Records hops to random targets on the twin.

    Returns:
        For each step the state, applied command and error, shape (steps, 6); for each tick of the first hops the hip
        height, rates of the hip, leg angles, their rates and torques, shape (ticks, 9); the ticks of each such hop.
    """
    robot, gains, bounds, nominal = RobotParameters(), Gains(), CommandBounds(), ApexMap()
    rng = np.random.default_rng(seed)
    twin, controller = Twin(robot, RealityGap(), rng), StepController(nominal)
    ticks, ends, rows = [], [], []

    def on_ticks(rows: Rows, step: int) -> None:
        if step and len(ends) < trajectory_hops:
            true = twin.true_state()
            ticks.append([true.hip[1], *true.hip_rate, *true.leg, *true.leg_rate, *Tick.of(rows[0]).applied])

    with RigPlant(twin, HopperControl(robot, gains, bounds), on_ticks, at_once=1) as plant:
        state = plant.start()
        for _ in range(steps):
            command = controller(state, rng.uniform([0.0, 0.53], [0.4, 0.64])).command
            step = plant.take_step(command)
            error = step.next_state - nominal(state, step.applied)
            rows.append([*state, *step.applied, *error])
            ends.append(len(ticks))
            state = step.next_state
    return np.array(rows), np.array(ticks), np.diff([0, *ends[:trajectory_hops]])


def fit_and_predict(points: Array, values: Array, input_scale: Array, value_scale: float) -> tuple[float, float]:
    """Time of a fit [s] and of a mean with its gradient [s]."""
    begin = perf_counter()
    process = fit_gaussian_process(points, values, input_scale, value_scale)
    fitted = perf_counter() - begin
    calls = []
    for point in points[:100]:
        begin = perf_counter()
        process.mean(point)
        process.mean_gradient(point)
        calls.append(perf_counter() - begin)
    return fitted, float(np.median(calls))


def show(name: str, hops: int, points: int, fitted: float, predicted: float | None, mark: str = "") -> None:
    """Prints a row; the memory of the factor is 8 N² bytes."""
    prediction = "" if predicted is None else f"{1e6 * predicted:.0f} µs"
    print(f"{name:18}{hops:6}{points:9}{fitted:14.3g} s{mark:1}{prediction:>15}{8e-6 * points**2:14.4g} MB", flush=True)


def main() -> None:
    """Measures and prints the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--hops", type=int, default=4, help="number of hops in the time domain at 1,000 Hz")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()

    most_hops = max(options.hops, 8)
    steps, ticks, hop_ticks = record(PAPER_STEPS, most_hops, options.seed)
    print(f"{hop_ticks.mean():.0f} ticks of 1 ms in a hop\n")
    print(f"{'samples':18}{'hops':>6}{'points':>9}{'fit':>16}{'mean, gradient':>16}{'factor':>16}")
    space = ApexMap().space
    scale = np.concatenate([space.state_scale, space.command_scale])
    with threadpool_limits(limits=1):
        fit_and_predict(steps[:20, :4], steps[:20, 4], scale, space.state_scale[0])  # compiles the code
        for hops in (20, PAPER_STEPS):
            times = fit_and_predict(steps[:hops, :4], steps[:hops, 4], scale, space.state_scale[0])
            show("one per hop", hops, hops, *times)
        largest = (0.0, 0)
        for rate in RATES:
            every = 1000 // rate
            for hops in (1, 2, 4, 8):
                if hops > most_hops or hops * rate > 1000 * options.hops:
                    break
                trajectory = ticks[: hop_ticks[:hops].sum() : every]
                points, values = trajectory[:-1], np.diff(trajectory[:, 2])
                fitted, predicted = fit_and_predict(points, values, np.ptp(ticks, axis=0) / 2, np.ptp(values) / 2)
                show(f"{rate} Hz", hops, len(points), fitted, predicted)
                largest = max(largest, (fitted, len(points)), key=lambda fit: fit[1])
            paper = int(PAPER_STEPS * hop_ticks.mean() / every)
            show(f"{rate} Hz", PAPER_STEPS, paper, largest[0] * (paper / largest[1]) ** 3, None, "*")


if __name__ == "__main__":
    main()

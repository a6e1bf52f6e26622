"""Difference of the twin without a gap from the physics model, step by step, at several tick lengths.

With short ticks the twin must equal the model. At 1 kHz the remaining difference must be the effect of torques held
from tick to tick: it is proportional to the tick, and the model with held torques (`SampledApexMap`) has most of it.

    ./go python -m benchmarks.twin_fidelity --steps 50
"""

import argparse
from concurrent.futures import ProcessPoolExecutor

import numpy as np

from benchmarks.sampled_map import SampledApexMap
from stepgap.control.step_controller import StepController
from stepgap.plants.rig_plant import RigPlant
from stepgap.robots.hopper import CommandBounds, Gains, RobotParameters
from stepgap.robots.hopper.model.apex_map import ApexMap
from stepgap.robots.hopper.tick.hop_control import HopperControl
from stepgap.robots.hopper.twin.reality_gap import RealityGap
from stepgap.robots.hopper.twin.twin import Twin

TICKS = (1e-4, 2e-4, 5e-4, 1e-3)


def errors_at(tick: float, steps: int, seed: int) -> np.ndarray:
    """Next state over random steps, twin − model and twin − model with held torques; shape (2, steps, 2)."""
    robot, gains, bounds, nominal = RobotParameters(), Gains(), CommandBounds(), ApexMap()
    sampled = SampledApexMap(tick=tick)
    rng, errors = np.random.default_rng(seed), []
    controller = StepController(nominal)
    with RigPlant(Twin(robot, RealityGap.none(), rng, tick=tick), HopperControl(robot, gains, bounds)) as plant:
        state = plant.start()
        for _ in range(steps):
            command = controller(state, rng.uniform([0.0, 0.53], [0.4, 0.64])).command
            record = plant.take_step(command)
            errors.append([record.next_state - model(state, record.applied) for model in (nominal, sampled)])
            state = record.next_state
    return np.swapaxes(errors, 0, 1)


def main() -> None:
    """Prints a line per tick length."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=50)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    print("tick [ms]   model          speed error [m/s]: mean, largest     height error [m]: mean, largest")
    with ProcessPoolExecutor(2) as pool:
        found = pool.map(errors_at, TICKS, [options.steps] * len(TICKS), [options.seed] * len(TICKS))
        for tick, errors in zip(TICKS, found, strict=True):
            for model, error in zip(("continuous", "held torques"), errors, strict=True):
                mean, largest = error.mean(axis=0), np.abs(error).max(axis=0)
                speed, height = (f"{mean[i]:+20.5f} {largest[i]:10.5f}" for i in (0, 1))
                print(f"{1e3 * tick:9.1f}   {model:12} {speed} {height}", flush=True)


if __name__ == "__main__":
    main()

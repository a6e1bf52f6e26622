"""Whether the control loop that holds the leg in flight is stable on twins of the family, by their linear model.

The leg folds against its inertia and that of the rotors; the torque is that of the posture gains from angles and rates
of the last ticks, held for a tick, after the delay, the lag and the scale of the drives. Friction is left out. The
table has the growth of a vibration per tick, for the default damping gain and for half of it; above 1 it grows until
the torque limit bounds it. Lost frames add delay.

    ./go python benchmarks/posture_loop.py [--seeds 100-109]
"""

import argparse
from dataclasses import replace

import numpy as np

from stepgap.robots.hopper import Gains, RobotParameters
from stepgap.robots.hopper.model.dynamics import leg_inertia, masses_of
from stepgap.robots.hopper.model.joint_control import joint_law
from stepgap.robots.hopper.model.leg import four_bar
from stepgap.robots.hopper.twin.reality_gap import RealityGap

TICK, PARTS, TICKS = 1e-3, 40, 400
"""Length of a tick [s], steps of integration in it, and ticks that are simulated."""


def folding_inertia(gap: RealityGap) -> float:
    """Inertia against folding the leg in flight at the landing posture, where the hip moves freely [kg·m²]."""
    model, mass, inertia = RobotParameters(), gap.leg_mass_scale, gap.leg_inertia_scale
    robot = replace(
        model,
        top_mass=mass * model.top_mass,
        bottom_mass=mass * model.bottom_mass,
        top_inertia=inertia * model.top_inertia,
        bottom_inertia=inertia * model.bottom_inertia,
    )
    masses, angle = masses_of(robot), joint_law(robot, Gains()).landing_angle
    leg = leg_inertia(masses, four_bar(masses.leg, angle), angle)
    return leg[5] + 2 * gap.rotor_inertia - leg[1] ** 2 / masses.y


def growth(gap: RealityGap, gains: Gains) -> float:
    """Factor by which a vibration grows from tick to tick."""
    step, inertia = TICK / PARTS, folding_inertia(gap)
    kept = np.exp(-step / max(gap.torque_lag, 1e-9))
    waiting = [0.0] * round(gap.delay / step)
    angle, speed, torque, before, sizes = 0.01, 0.0, 0.0, [0.01, 0.01], []
    for _ in range(TICKS):
        asked = -gains.position_gain * angle - gains.damping_gain * (angle - before[0]) / (2 * TICK)
        before = [before[1], angle]
        for _ in range(PARTS):
            waiting.append(asked)
            torque = kept * torque + (1 - kept) * waiting.pop(0)
            speed += step * gap.torque_scale * torque / inertia
            angle += step * speed
        sizes.append(abs(angle) + 0.0025 * abs(speed))
    early, late = max(sizes[TICKS // 4 : TICKS // 2]), max(sizes[3 * TICKS // 4 :])
    return (late / early) ** (2 / TICKS)


def main() -> None:
    """Prints a line per twin."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", default="100-109")
    first, last = map(int, parser.parse_args().seeds.split("-"))
    print("twin   delay + lag [ms]   growth per tick   with half the damping gain")
    for seed in range(first, last + 1):
        gap, gains = RealityGap.random(np.random.default_rng(seed)), Gains()
        half = growth(gap, replace(gains, damping_gain=gains.damping_gain / 2))
        print(
            f"{seed:4d} {1e3 * (gap.delay + gap.torque_lag):18.2f} {growth(gap, gains):17.4f} {half:28.4f}", flush=True
        )


if __name__ == "__main__":
    main()

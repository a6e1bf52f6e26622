"""Stops without a fault: random twins hop with lost frames and late ticks, under the limits of examples/rig.toml.

Every twin makes hops with random commands; after a stop or a fall it is deployed again. Of the lost frames, half never
reach the drives, which keep their torques while the master reports the new ones, and half are lost on the way back. A
late tick begins a millisecond late. Sensors are read in step with the frames (`sample_jitter` 0.1), and the limits are
the full ones from the first hop on.

Of each twin: hops, deployments, ticks, lost frames, late ticks, largest joint speed, largest jump of a motor as a
multiple of its threshold, largest evidence against the yaw as a part of that for which it is doubted, and the reasons
of all stops, with the largest joint speed of the deployments that ended so.
The last line counts the stops by doubtful sensors. Shorter physics steps near the ground than the twin's 0.25 ms show
what is an error of the simulation.

    ./go python benchmarks/false_alarms.py [--seeds 100-109] [--hops 227] [--lost 0.05] [--late 0.005]
        [--joint-speed 80] [--no-other-limits] [--physics-step 0.00025] [--roughness 0.003] [--slope 0.003]
        [--ramps 0.1] [--stairs 0.056]
"""

import argparse
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import count
from math import inf
from pathlib import Path
from typing import NamedTuple

import numpy as np

from stepgap.base.compiled import as_written
from stepgap.hardware.hopper.ethercat import read_rig_settings
from stepgap.plants.tick_control import Mode, Order, TickFlag
from stepgap.rigs.rig import HEALTHY, LOST, Health, Rig, RigFault, Torques
from stepgap.robots.ground import FLAT_GROUND, UnevenGround
from stepgap.robots.hopper import Gains, RobotParameters
from stepgap.robots.hopper.tick.closures import MOST_EVIDENCE
from stepgap.robots.hopper.tick.encoder_track import EncoderTrack, with_angle
from stepgap.robots.hopper.tick.hop_control import HopControl
from stepgap.robots.hopper.tick.limits import SafetyLimits
from stepgap.robots.hopper.tick.plausibility import jump_ratio
from stepgap.robots.hopper.tick.safety import DOUBTS, Limited
from stepgap.robots.hopper.tick.sensors import HopperReading, hopper_sensors
from stepgap.robots.hopper.tick.tick_row import TICK_UNITS
from stepgap.robots.hopper.twin import twin as twin_module
from stepgap.robots.hopper.twin.model import GroundProfile
from stepgap.robots.hopper.twin.reality_gap import RealityGap
from stepgap.robots.hopper.twin.twin import Twin

ROBOT, GAINS, TICK = RobotParameters(), Gains(), 1e-3
START_COMMAND, LEAST_COMMAND, MOST_COMMAND = (-4.0, -3.0), (-10.0, -9.0), (2.0, 3.0)
"""Command of the first hop, and the range of the others [N]."""
OTHER_LIMITS = ["lean_angle", "fold_angle", "longest_leg", "highest_hip", "continuous_torque", "mean_power"]
"""Largest values that are not limited if only torques, joint speed and sensors are judged."""
DEPLOYMENTS = 12
"""Most deployments of a twin."""
DIRECTIONS = ("forward", "backward", "few", "many")
"""Kinds of evidence."""
ALPHA_1, ALPHA_2, JOINT_SPEED = map(tuple(TICK_UNITS).index, ("alpha_1", "alpha_2", "joint_speed"))
"""Columns of a row of the tick log."""
EXAMPLE = Path(__file__).parents[1] / "examples" / "rig.toml"


class Trouble(NamedTuple):
    """Probabilities that the frame of a tick is lost, and that a tick begins late."""

    lost: float = 0.0
    late: float = 0.0


def example_limits() -> SafetyLimits:
    """Limits of the example, with sensors that are read in step with the frames, from the first hop on."""
    limits = read_rig_settings(EXAMPLE).limits
    return replace(limits, sample_jitter=0.1, first_share=1.0, lost_frames=5, stale_ticks=5, late_ticks=5)


def unchanged(number: int, reading: HopperReading) -> HopperReading:
    """The reading without a fault."""
    return reading


def deployment(
    twin: Rig,
    limits: SafetyLimits,
    rng: np.random.Generator,
    trouble: Trouble,
    change: Callable[[int, HopperReading], HopperReading] = unchanged,
    ground: UnevenGround = FLAT_GROUND,
    evidence: Sequence[float] = (),
) -> Iterator[tuple[HopControl, int, Torques, Health]]:
    """Ticks with random commands until the robot is stopped or falls: control, flags, torques before, health.

    Args:
        twin: The robot.
        limits: Limits of the safety function.
        rng: Draws commands, lost frames and late ticks.
        trouble: Their probabilities.
        change: Returns the reading of a tick as a fault of a sensor changes it.
        ground: Whether heights are measured above the ground that the foot finds.
        evidence: That of the deployment before.
    """
    twin.connect()
    control, reading = HopControl(hopper_sensors(twin.sensor_model), ROBOT, GAINS, limits, ground), _reading(twin)
    time, given, applied, command = 0.0, (0.0, 0.0), (0.0, 0.0), START_COMMAND
    control.resume(evidence)
    for number in count():
        chance, health = rng.random(), HEALTHY
        if chance < trouble.lost:
            health = LOST
        else:
            if chance > 1 - trouble.late:
                time, health = time + TICK, Health(late=1)
                twin.write(given)
            reading = change(number, _reading(twin))
        torques, flags = control.tick(time, reading, Order(Mode.STEP, 1.0, command), applied, health)
        yield control, flags, applied, health
        if flags & (TickFlag.STOPPED | TickFlag.FAILED):
            return
        if flags & TickFlag.STEP_ENDED:
            command = tuple(rng.uniform(LEAST_COMMAND, MOST_COMMAND).tolist())
        arrives = chance >= trouble.lost / 2
        given = twin.write(torques if arrives else given)
        applied, time = given if arrives else torques, time + TICK


def _reading(rig: Rig) -> HopperReading:
    return HopperReading(*rig.read())


@dataclass
class Row:
    """A line of the table."""

    hops: int = 0
    deployments: int = 0
    ticks: int = 0
    lost: int = 0
    late: int = 0
    joint_speed: float = 0.0
    jump: float = 0.0
    evidence: float = 0.0
    alarms: int = 0
    stops: Counter[str] = field(default_factory=Counter)
    speeds: dict[str, float] = field(default_factory=dict)

    def __str__(self) -> str:
        """The columns."""
        stops = ", ".join(f"{n} × {why} (≤ {self.speeds[why]:.0f} rad/s)" for why, n in self.stops.items())
        return (
            f"{self.hops:5d} {self.deployments:4d} {self.ticks:8d} {self.lost:6d} {self.late:5d} "
            f"{self.joint_speed:6.0f} {self.jump:6.2f} {self.evidence:8.2f}   {stops or '–'}"
        )


@as_written
def largest_jump(settings, ticks):
    """Largest jump of a motor as a multiple of its threshold.

    Args:
        settings: Record of `TickSettings`.
        ticks: Time of the reading [s], angles [rad] and torques [N·m] of both motors; shape (k, 5).
    """
    model, limits, most = settings[0].sensor_model, settings[0].limits, 0.0
    unit = 2.0 * np.pi / model.motor_counts
    motor_1 = motor_2 = EncoderTrack(0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    for time, angle_1, angle_2, torque_1, torque_2 in ticks:
        motor_1, jump_1 = with_angle(motor_1, model.tick, unit, time, angle_1, torque_1, False)
        motor_2, jump_2 = with_angle(motor_2, model.tick, unit, time, angle_2, torque_2, False)
        most = max(most, jump_ratio(limits, limits.jump_angle, jump_1, jump_2, model.tick, unit))
        most = max(most, jump_ratio(limits, limits.jump_angle, jump_2, jump_1, model.tick, unit))
    return most


def deploy(
    row: Row,
    twin: Twin,
    limits: SafetyLimits,
    rng: np.random.Generator,
    trouble: Trouble,
    hops: int,
    ground: UnevenGround,
) -> None:
    """Adds a deployment to a row, until the row has its hops or the robot is stopped."""
    fastest, ticks = 0.0, []
    row.deployments += 1
    for control, flags, applied, health in deployment(twin, limits, rng, trouble, ground=ground):
        _, memory, tick = control.memory
        alpha_1, alpha_2 = tick[ALPHA_1], tick[ALPHA_2]
        ticks.append((memory["sampled"][0], alpha_1 + alpha_2, alpha_1 - alpha_2, *applied))
        row.lost, row.late = row.lost + health.frame_lost, row.late + health.late
        fastest = max(fastest, float(tick[JOINT_SPEED]))
        found = memory["sensors"]["closures"]["evidence"][0]
        row.evidence = max(row.evidence, *(float(found[name]) / MOST_EVIDENCE for name in DIRECTIONS))
        row.hops += int(flags & TickFlag.STEP_ENDED != 0)
        ended = flags & (TickFlag.STOPPED | TickFlag.FAILED) != 0
        if ended:
            reason = control.stopped.split(" (")[0] or control.status.label
            row.stops[reason] += 1
            row.speeds[reason] = max(row.speeds.get(reason, 0.0), fastest)
            row.alarms += Limited(int(memory["watch"]["stopped"][0])) & DOUBTS != 0
        if ended or row.hops == hops:
            row.jump = max(row.jump, float(largest_jump(control.memory[0], np.array(ticks))))
            break
    row.ticks += len(ticks)
    row.joint_speed = max(row.joint_speed, fastest)


def measure(
    trouble: Trouble,
    limits: SafetyLimits,
    hops: int,
    physics_step: float,
    floor: dict[str, float],
    ground: UnevenGround,
    seed: int,
) -> Row:
    """The row of a twin, on a floor that may be more uneven than it draws, or on uneven ground."""
    twin_module.STANCE_STEP = physics_step
    rng = np.random.default_rng(seed)
    gap = replace(RealityGap.random(rng), **floor)
    profile = GroundProfile(gap, ROBOT.boom_length, rng, ground) if ground.is_measured else None
    twin, row = Twin(ROBOT, gap, rng, ground=profile), Row()
    while row.hops < hops and row.deployments < DEPLOYMENTS:
        try:
            deploy(row, twin, limits, rng, trouble, hops, ground)
        except RigFault as fault:
            row.stops[str(fault)] += 1
            row.speeds[str(fault)] = np.nan
    return row


def main() -> None:
    """Prints the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", default="100-109")
    parser.add_argument("--hops", type=int, default=227)
    parser.add_argument("--lost", type=float, default=0.05)
    parser.add_argument("--late", type=float, default=0.005)
    parser.add_argument("--joint-speed", type=float, default=80.0)
    parser.add_argument("--no-other-limits", action="store_true", help="judge torques, joint speed and sensors alone")
    parser.add_argument("--physics-step", type=float, default=2.5e-4)
    parser.add_argument("--roughness", type=float, help="standard deviation of the height of the floor [m]")
    parser.add_argument("--slope", type=float, help="tilt of the floor [rad]")
    parser.add_argument("--ramps", type=float, default=0.0, help="slope of measured ramps")
    parser.add_argument("--stairs", type=float, default=0.0, help="height of measured stairs [m]")
    parser.add_argument("--processes", type=int, default=1)
    options = parser.parse_args()
    first, last = map(int, options.seeds.split("-"))
    limits, alarms, total = replace(example_limits(), joint_speed=options.joint_speed), 0, Counter()
    if options.no_other_limits:
        limits = replace(limits, **dict.fromkeys(OTHER_LIMITS, inf), shortest_leg=0.0, lowest_hip=-inf)
    given = {"ground_roughness": options.roughness, "ground_slope": options.slope}
    floor = {name: value for name, value in given.items() if value is not None}
    ground = UnevenGround(slope=options.ramps, stair_height=options.stairs)
    if ground.is_measured:
        limits = replace(limits, ground_height=max(limits.ground_height, 2.0 * options.stairs + options.ramps))
    trouble = Trouble(options.lost, options.late)
    task = partial(measure, trouble, limits, options.hops, options.physics_step, floor, ground)
    print("twin   hops runs    ticks   lost  late  rad/s   jump evidence   stops", flush=True)
    with ProcessPoolExecutor(options.processes) as pool:
        for seed, row in zip(range(first, last + 1), pool.map(task, range(first, last + 1)), strict=True):
            print(f"{seed:4d}  {row}", flush=True)
            alarms += row.alarms
            total += Counter(hops=row.hops, ticks=row.ticks, lost=row.lost, late=row.late)
    print(f"{alarms} stops by doubtful sensors in {dict(total)}")


if __name__ == "__main__":
    main()

"""Warm starts from wrong steps: does a robot that begins with them do worse than one that begins with nothing?

The steps that are known before the first deployment are those of deployment 0, without correction, of some source:

- `right`: the same twin with another noise, to count false alarms;
- `fleet`: runs of four other random twins, and one of the same;
- `other`: another random twin;
- `inverted`: the twin itself, but what the commands did is recorded with the wrong sign;
- `swapped`: the twin itself, with the two recorded commands exchanged, in half ranges;
- `offset`: the twin itself, with every recorded height at the end of a step too high by 14 standard deviations.

Printed are the ratios of the error of hops 2–5 [half ranges], and of all hops, to those of the same deployment without
a warm start, median and 90 % quantile over the twins, in how many twins a ratio exceeds 1.2, and in how many the
learner raised an alarm by hop 2, and at any hop. Falls are counted, and not in the ratios. Without a warm start, the
robot learns from its first hop on (`online`), or not before its second deployment (`default`); with one, both learn.

    ./go python -m benchmarks.wrong_warm_start [--twins 30] [--first-twin 500]
"""

import argparse
from collections.abc import Callable, Mapping
from itertools import product
from typing import NamedTuple

import numpy as np

from benchmarks.disturbed_plant import METHODS, alarms_after, finished, squared_errors, tracked, uncorrected
from benchmarks.trust_robots import TrustRobot, hopper
from stepgap.base.blas import one_blas_thread
from stepgap.base.random_streams import random_stream
from stepgap.control.reference import Reference
from stepgap.learning.learner import Learner
from stepgap.learning.steps import Steps, as_past, joined

STEPS = 30
"""Number of hops of a deployment."""

FROM, TO = 1, 5
"""Hops 2 to 5."""

OFFSET = np.array([0.0, 14 * 0.003])
"""Wrong offset of speed and height; a single step of a hopper that has learned scatters by some 3 mm."""

OTHER = 1_000_000
"""What is added to the number of a robot for that of another one."""


class Outcome(NamedTuple):
    """Of a warm start on a twin, beside a method without one.

    Attributes:
        early: Error of hops 2–5 relative to that without a warm start; NaN if one of the two fell before hop 5.
        all: Error of all hops relative to that without a warm start.
        fell: Whether the robot fell, and whether it fell without a warm start.
        alarms: Numbers of the hops with an alarm.
    """

    early: float
    all: float
    fell: tuple[bool, bool]
    alarms: tuple[int, ...]


def inverted(steps: Steps, robot: TrustRobot) -> Steps:
    """Steps whose recorded commands lie on the other side of the middle of their bounds."""
    commands = 2 * robot.nominal.space.command_centre - steps.requested
    return steps.with_columns(command=commands, requested=commands, applied=commands)


def swapped(steps: Steps, robot: TrustRobot) -> Steps:
    """Steps whose recorded commands are in each other's place."""
    space = robot.nominal.space
    commands = space.command_at(np.roll(space.point_of(steps.requested), 1, axis=1))
    return steps.with_columns(command=commands, requested=commands, applied=commands)


def wrong_heights(steps: Steps, robot: TrustRobot) -> Steps:
    """Steps of a hopper whose next states are wrong by `OFFSET`."""
    return steps.with_columns(next_state=steps.next_state + np.resize(OFFSET, len(robot.nominal.space.state)))


def as_recorded(steps: Steps, robot: TrustRobot) -> Steps:
    """The steps themselves."""
    return steps


SOURCES: Mapping[str, Callable[[Steps, TrustRobot], Steps]] = {
    "right": as_recorded,
    "fleet": as_recorded,
    "other": as_recorded,
    "inverted": inverted,
    "swapped": swapped,
    "offset": wrong_heights,
}
"""What is done to the steps of a source; `other` is another robot, and so are most of `fleet`."""

FLEET = 4
"""Number of other robots in the fleet."""


def known_steps(
    source: str, make: Callable[[int], TrustRobot], number: int, shorten: Callable[[Reference], Reference]
) -> Steps:
    """Steps of a source, numbered as deployments before the first one.

    Args:
        source: A name of `SOURCES`.
        make: Makes a robot from its number.
        number: Number of the robot.
        shorten: Applied to its reference.
    """
    others = range(number + OTHER, number + OTHER + (FLEET if source == "fleet" else source == "other"))
    runs = list[Steps]()
    for each in (*others, *(() if source == "other" else (number,))):
        robot = make(each)
        live = robot.live(random_stream(each, 3))
        steps = tracked(uncorrected(robot.nominal), live.plant, shorten(robot.reference), 0)
        runs.append(SOURCES[source](steps, robot))
    return as_past(joined(runs))


def beginning(reference: Reference) -> Reference:
    """The first `STEPS` targets of a reference."""
    return Reference(reference.names, reference.targets[:STEPS])


def measure(twin: int) -> list[tuple[str, str, Outcome]]:
    """All sources on a twin, beside all methods."""
    robot = hopper(twin)

    def deployment(known: Steps, method: str = "default") -> tuple[Steps, tuple[int, ...]]:
        learner = Learner.start(robot.nominal, known, METHODS[method], 0, robot.priors)
        steps = tracked(learner, robot.live(random_stream(twin, 4)).plant, beginning(robot.reference), 0)
        return steps, alarms_after(learner, steps)

    with one_blas_thread():
        without = {method: deployment(Steps(robot.nominal.space), method)[0] for method in METHODS}
        found = {source: deployment(known_steps(source, hopper, twin, beginning)) for source in SOURCES}
    return [(source, method, _compared(*found[source], without[method])) for source in SOURCES for method in METHODS]


def _compared(steps: Steps, alarms: tuple[int, ...], without: Steps) -> Outcome:
    errors = squared_errors(steps), squared_errors(without)
    count = min(map(len, errors))
    early, whole = (
        np.sqrt(errors[0][part].mean() / errors[1][part].mean()) if count >= TO else np.nan
        for part in (slice(FROM, TO), slice(count))
    )
    return Outcome(float(early), float(whole), (steps.failed_steps > 0, without.failed_steps > 0), alarms)


def main() -> None:
    """Prints a row for each source and method."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--twins", type=int, default=30)
    parser.add_argument("--first-twin", type=int, default=500)
    given = parser.parse_args()
    twins = range(given.first_twin, given.first_twin + given.twins)
    rows = [row for _, found in finished(measure, twins) for row in found]
    print(
        "error / without warm start: hops 2–5 median, p90, > 1.2 | all hops median, p90, > 1.2 | falls, without | ",
        end="",
    )
    print("alarm by hop 2, at any hop")
    for source, method in product(SOURCES, METHODS):
        found = [outcome for name, way, outcome in rows if (name, way) == (source, method)]
        cells = []
        for values in ([each.early for each in found], [each.all for each in found]):
            known = np.array(values)[np.isfinite(values)]
            middle, most = np.quantile(known, [0.5, 0.9]) if len(known) else (np.nan, np.nan)
            cells.append(f"{middle:6.2f} {most:6.2f} {np.sum(known > 1.2):3d} of {len(known)}")
        falls = ", ".join(str(sum(each.fell[number] for each in found)) for number in (0, 1))
        early = sum(any(hop <= 2 for hop in each.alarms) for each in found)
        any_hop = sum(bool(each.alarms) for each in found)
        print(f"{source:9}{method:8} {' | '.join(cells)} | {falls} | {early}, {any_hop}")


if __name__ == "__main__":
    main()

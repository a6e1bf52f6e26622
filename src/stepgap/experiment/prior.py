"""A prior over robots from recorded runs, one for each robot."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from stepgap.base.errors import InputError
from stepgap.base.versions import versions_here
from stepgap.experiment.run import Run
from stepgap.learning.observations import Observations, observe
from stepgap.learning.prior import LEAST_FOR_PRIOR, fit_prior
from stepgap.records.prior_file import PriorFile


class RobotSteps(NamedTuple):
    """What is known of one robot.

    Attributes:
        folder: Folder of its run.
        robot: Name of the kind of robot.
        nominal: Kind of its nominal map.
        observations: Errors of that map.
    """

    folder: Path
    robot: str
    nominal: str
    observations: Observations


def steps_of_robot(folder: Path) -> RobotSteps:
    """Reads a run, of which all steps count.

    Raises:
        InputError: It is not a run, its files are not of one run, or its nominal map is not known.
    """
    run = Run(folder).checked()
    nominal = run.needed(run.nominal)
    settings = run.needed(run.settings)
    kind = "" if settings.nominal.linear else settings.nominal.kind
    return RobotSteps(folder, settings.robot.name, kind, observe(run.recorded.planned(), nominal))


def find_prior(robots: Sequence[RobotSteps]) -> PriorFile:
    """Finds the prior over robots.

    Raises:
        InputError: There are too few, or they differ in state, command, ranges or nominal map.
    """
    if len(robots) < LEAST_FOR_PRIOR:
        raise InputError(f"RUNS: {len(robots)} robots with enough steps, but a prior needs at least {LEAST_FOR_PRIOR}")
    first = robots[0]
    for one in robots:
        if one[1:3] != first[1:3] or one.observations.space != first.observations.space:
            remedy = "the robot, the ranges of its state and command, and the nominal map must be the same"
            raise InputError(f"{one.folder}: differs from {first.folder}; {remedy}")
    if not first.nominal:
        raise InputError(f"{first.folder}: a prior is for the nominal map as it is, but nominal.linear is true")
    provenance = {
        "robots": len(robots),
        "steps": sum(len(robot.observations) for robot in robots),
        "stepgap": versions_here()["stepgap"],
    }
    return PriorFile(fit_prior([robot.observations for robot in robots]), first.robot, first.nominal, provenance)

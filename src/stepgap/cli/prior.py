"""The verb `stepgap prior`: what the errors of many robots have in common."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING

from stepgap.base.errors import InputError
from stepgap.base.output_files import check_new, write_new
from stepgap.cli.options import Flag
from stepgap.cli.terminal import announces_compilation, warn

if TYPE_CHECKING:  # slow imports are made where they are used
    from stepgap.experiment.prior import RobotSteps

_LEAST_STEPS = 15  # Number of completed steps from which a run says something about its robot


@announces_compilation
def prior(*runs: Path, out: Path, quiet: Flag = False) -> None:
    """Find a prior over robots from the steps of many of them, so that a new one of the kind needs fewer steps.

    Args:
        runs: Folders of runs, one for each robot, or folders of many runs, such as that of a sweep over random twins.
        out: New file of the prior (JSON), which `stepgap run --prior` takes.
        quiet: Print only the path of the file.
    """
    from stepgap.cli.progress import progress_bar
    from stepgap.experiment.inputs import run_folders
    from stepgap.experiment.prior import find_prior, steps_of_robot

    check_new(out, "--out")
    folders = [folder for argument in runs for folder in run_folders(argument)]
    folders = [*{folder.resolve(): folder for folder in folders}.values()]  # each counts once
    if not folders:
        raise InputError("RUNS: give the folders of runs, one for each robot, or of a sweep over random twins")
    robots: list[RobotSteps] = []
    with progress_bar("reading", quiet) as progress:
        for number, folder in enumerate(folders, 1):
            robots.append(steps_of_robot(folder))
            progress(number, len(folders))
    poor = [robot.folder for robot in robots if len(robot.observations) < _LEAST_STEPS]
    if poor:
        warn(f"left out, since it has fewer than {_LEAST_STEPS} completed steps: {', '.join(map(str, poor))}")
    file = find_prior([robot for robot in robots if robot.folder not in poor])
    write_new(out, "--out", file.text())
    if not quiet:
        for name, belief in zip(file.prior.names, file.prior.coordinates, strict=False):
            spread = float(belief.covariance[0, 0]) ** 0.5  # of the constant feature
            sentence = f"robots differ by {spread:.2g} half ranges, steps by {belief.noise_std:.2g}"
            print(f"{name}: {sentence}", file=sys.stderr)

"""A sweep: one experiment for every combination of the points of its axes.

An axis of any kind, a list, an evenly spaced grid, a Sobol' sequence, random twins or seeds, is a list of points,
and a point gives values to one or several settings. Case i is the i-th combination, in which the last axis changes
fastest. A case is made when it is needed, so that a sweep of 10⁵ cases takes little memory.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from hashlib import sha256
from math import prod
from typing import Any, Literal, get_args

import numpy as np
import tomli_w

from stepgap.base.errors import InputError
from stepgap.base.random_streams import random_stream
from stepgap.experiment.inputs import experiment_files, load_known, load_reference
from stepgap.experiment.settings import Experiment, changed_experiment, merged_experiment, names_file, nested
from stepgap.step import StepSpace

SWEEP_FILE = "sweep.toml"  # File in the folder of a sweep with its axes
POINTS_SHA256 = "points_sha256"  # Key in that file: SHA-256 of the points of the axes

TWIN_NUMBER = "twin"
SEED = "seed"
"""Names of the axes of random twins and of seeds."""

Keep = Literal["runs", "steps", "nothing"]
"""Files of a case that are kept: those of its run, its settings and steps, or none."""

KEEP: tuple[Keep, ...] = get_args(Keep)  # All values of `Keep`


@dataclass(frozen=True)
class Axis:
    """Points along which settings change together.

    Attributes:
        names: Dotted names of settings, or `twin`.
        points: Values of these settings at each point.
    """

    names: tuple[str, ...]
    points: tuple[tuple[Any, ...], ...]


@dataclass(frozen=True)
class Sweep:
    """A base experiment and the axes along which its settings change; it is a `Plan`.

    Attributes:
        base: Settings of all cases that no axis changes.
        axes: The axes; the last one changes fastest.
        table: The TOML table of the file, from which the axes were made.
        keep: Files of a case that are kept.
    """

    base: Experiment
    axes: tuple[Axis, ...]
    table: Mapping[str, Any]
    keep: Keep

    def __len__(self) -> int:
        return prod(len(axis.points) for axis in self.axes)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all settings on the axes, in their order."""
        return tuple(name for axis in self.axes for name in axis.names)

    @property
    def space(self) -> StepSpace:
        """State and command of the robot."""
        return self.base.space

    def settings(self, number: int) -> dict[str, Any]:
        """Values of the settings on the axes in a case, by name."""
        index = np.unravel_index(number, [len(axis.points) for axis in self.axes])
        points = [axis.points[i] for axis, i in zip(self.axes, index, strict=True)]
        return dict(zip(self.names, (value for point in points for value in point), strict=True))

    def experiment(self, number: int) -> Experiment:
        """Settings of a case.

        Raises:
            InputError: They are not valid together.
        """
        changed = with_changes(self.base, self.settings(number))
        return changed_experiment(*changed, lambda name: f"case {number}: {name}")

    @property
    def files(self) -> Mapping[str, str]:
        """Texts of a folder from which the sweep can be read again, by file name."""
        base = _input_files(self.base)
        table = {**self.table, "base": "experiment.toml", POINTS_SHA256: points_digest(self.base, self.axes)}
        return {SWEEP_FILE: tomli_w.dumps(table), **base}

    def case(self, number: int) -> dict[str, Any]:
        """Files of the experiment of a case, and what to keep."""
        return {"keep": self.keep, "files": _input_files(self.experiment(number))}


def points_digest(base: Experiment, axes: Sequence[Axis]) -> str:
    """SHA-256 of the points of axes, with the content of the files that they name.

    It recognises points of other versions of NumPy and SciPy, and files that were changed.

    Raises:
        InputError: A file cannot be read.
    """
    content = repr([(axis.names, axis.points) for axis in axes])
    for axis in axes:
        for point in axis.points if any(names_file(base.robot, name) for name in axis.names) else ():
            content += repr(_input_files(merged_experiment(base, nested(zip(axis.names, point, strict=True)), str)))
    return sha256(content.encode()).hexdigest()


def _input_files(experiment: Experiment) -> dict[str, str]:
    """Texts of all files of an experiment, by their names in the folder of a run."""
    space = experiment.space
    return experiment_files(experiment, load_reference(experiment, space), load_known(experiment, space))


def with_changes(base: Experiment, changes: Mapping[str, Any]) -> tuple[Experiment, dict[str, Any]]:
    """An experiment and a TOML table of its changes; a random twin is in the experiment already.

    Args:
        changes: Values by dotted name; `twin` is the number of a random twin, whose differences from the model replace
            those of the experiment before the other settings change.
    """
    table = dict(changes)
    if TWIN_NUMBER in table:
        robot = base.robot.randomised(random_stream(table.pop(TWIN_NUMBER)))
        if robot is None:
            raise InputError(
                f"twins: robot '{base.robot.name}' has no random differences from its model; remove this key"
            )
        base = replace(base, robot=robot)
    return base, nested(table.items())

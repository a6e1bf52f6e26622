"""A plant to which something happens between its steps, one deployment on it, and many of them on all cores.

`benchmarks/changes.py`, `wrong_warm_start.py`, `trust.py` and others use it, so that each measures the same robots with
the same noise, with learning and without.
"""

import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import closing
from dataclasses import replace
from functools import reduce
from typing import TypeVar

import numpy as np

from stepgap.base.start_method import process_context, usable_cores
from stepgap.control.reference import Reference
from stepgap.experiment.deployment import deploy
from stepgap.experiment.inputs import load_priors
from stepgap.experiment.settings import Experiment
from stepgap.learning.learner import Learner
from stepgap.learning.prior import Prior
from stepgap.learning.settings import LearningSettings
from stepgap.learning.steps import Steps
from stepgap.plants.plant import Plant
from stepgap.rigs.rig import RigFault
from stepgap.robots.robot import Robot
from stepgap.step import Array, StepMap, StepRecord, StepSpace, StepStatus

_Case = TypeVar("_Case")
_Found = TypeVar("_Found")

Events = Mapping[int, Callable[[], None]]
"""What happens after a step, by the number of the step, from 1."""

METHODS: Mapping[str, LearningSettings] = {"default": LearningSettings(), "online": LearningSettings(online=True)}
"""Settings of the methods that are judged."""

UNCORRECTED = LearningSettings(residual="none")
"""Settings of a learner that does not learn."""


class DisturbedPlant(Plant):
    """A plant to which something happens, or that measures wrongly, after some of its steps.

    Args:
        plant: The plant itself.
        events: What happens to it.
        errors: What is added to the measured state at the end of a step, by the number of the step; shape (n,).
    """

    def __init__(self, plant: Plant, events: Events, errors: Mapping[int, Array] | None = None):
        self._plant, self._events, self._errors = plant, events, errors or {}
        self._number, self._error = 0, np.zeros(len(plant.space.state))

    @property
    def space(self) -> StepSpace:
        """Names, units and ranges of the plant."""
        return self._plant.space

    @property
    def fault(self) -> str:
        """The fault of the plant."""
        return self._plant.fault

    def start(self) -> Array:
        """Starts the plant."""
        self._number, self._error = 0, np.zeros(len(self.space.state))
        return self._plant.start()

    def take_step(self, command: Array) -> StepRecord:
        """A step of the plant; a wrong state at its end is also the wrong state at the start of the next one."""
        record, before = self._plant.take_step(command), self._error
        self._number += 1
        self._error = self._errors.get(self._number, np.zeros(len(before)))
        if record.status == StepStatus.OK:
            self._events.get(self._number, lambda: None)()
        return replace(record, state=record.state + before, next_state=record.next_state + self._error)

    def stop(self) -> None:
        """Stops the plant."""
        self._plant.stop()


def tracked(learner: Learner, plant: Plant, reference: Reference, iteration: int) -> Steps:
    """Steps of one deployment; none if the plant did not reach the start of its first step."""
    log = Steps(plant.space)
    with closing(deploy(learner, plant, reference.of(plant.space), iteration)) as steps:
        try:
            for logged in steps:
                log += [logged]
        except RigFault:
            if len(log):
                raise
    return log


def uncorrected(nominal: StepMap) -> Learner:
    """Learner that knows only the nominal map."""
    return Learner.start(nominal, Steps(nominal.space), UNCORRECTED, 0)


def own_priors(robot: Robot) -> list[Prior]:
    """The priors over robots with which a run of a robot begins that has default settings."""
    return [each.prior for each in load_priors(Experiment(robot), robot.space)]


def alarms_after(learner: Learner, steps: Steps) -> tuple[int, ...]:
    """Numbers of the steps of a deployment at which its learner raised an alarm."""
    return tuple(alarm.step for alarm in reduce(Learner.after, steps.completed(), learner).alarms)


def squared_errors(steps: Steps) -> Array:
    """Squared tracking error of each completed step, summed over the tracked coordinates [half ranges²]; shape (N,)."""
    return np.nansum((steps.tracking_errors() / steps.space.error_scale) ** 2, axis=1)


def finished(measure: Callable[[_Case], _Found], cases: Sequence[_Case]) -> Iterator[tuple[_Case, _Found]]:
    """Each case with what was measured, as soon as it is, in as many processes as there are cores."""
    with ProcessPoolExecutor(usable_cores(), mp_context=process_context()) as pool:
        waiting = {pool.submit(measure, case): case for case in cases}
        for number, future in enumerate(as_completed(waiting), 1):
            yield waiting[future], future.result()
            print(f"\r{number} of {len(cases)} cases", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)

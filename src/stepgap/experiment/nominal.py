"""The nominal map of an experiment: one of the robot's, a simulator's surrogate, a template, or one fitted to a log."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from stepgap.base.errors import InputError, StepGapError, message_of
from stepgap.base.random_streams import random_stream
from stepgap.experiment.settings import FROM_LOG, FROM_TEMPLATE, Experiment
from stepgap.records.steps_csv import RecordError, read_step_log
from stepgap.robots.nominal_maps.log_map import fit_log_map
from stepgap.robots.nominal_maps.simulator import SimulatorMap
from stepgap.robots.nominal_maps.surrogate_map import SurrogateMap, fit_surrogate, surrogate_from_dict
from stepgap.robots.nominal_maps.template_file import read_template
from stepgap.step import Array, StepMap, StepSpace


class Nominal(NamedTuple):
    """A nominal map.

    Attributes:
        map: The map.
        surrogate: Text of the file from which it can be read again, if a surrogate was fitted now; else empty.
    """

    map: StepMap
    surrogate: str = ""


def load_nominal(settings: Experiment, on_samples: Callable[[int, Array], None] = lambda count, error: None) -> Nominal:
    """The nominal map of an experiment; that of a simulator is a surrogate, which takes seconds to minutes to fit.

    Args:
        settings: Settings of the experiment.
        on_samples: Called with the number of simulated steps so far, and the error of the surrogate [state units].

    Raises:
        InputError: There is no such map, or its file is not valid.
    """
    kind, file, robot = settings.nominal.kind, settings.nominal.file, settings.robot
    if kind in (FROM_TEMPLATE, FROM_LOG):
        if not file:
            example = "template.toml" if kind == FROM_TEMPLATE else "steps.csv"
            raise InputError(f"nominal.kind = {kind}: give its file by nominal.file, such as {example}")
        return Nominal(_read_map(kind, Path(file), robot.space))
    maps = robot.nominal_maps()
    if kind not in maps:
        known = ", ".join([*maps, FROM_TEMPLATE, FROM_LOG])
        raise InputError(f"nominal.kind = {kind}: robot '{robot.name}' has no such map; it must be one of {known}")
    nominal = maps[kind]()
    if not isinstance(nominal, SimulatorMap):
        if file:
            raise InputError(f"nominal.file = {file}: nominal map '{kind}' needs no file")
        return Nominal(nominal)
    if file:
        return Nominal(_read_map(kind, Path(file), robot.space))
    surrogate = fit_surrogate(nominal, random_stream(settings.seed, 0, 2), on_samples=on_samples)
    return Nominal(surrogate, json.dumps(surrogate.to_dict()) + "\n")


def _read_map(kind: str, path: Path, space: StepSpace) -> StepMap:
    try:
        if kind == FROM_TEMPLATE:
            return read_template(path, space)
        if kind == FROM_LOG:
            return fit_log_map(read_step_log(path, space))
        return _read_surrogate(path, space)
    except (OSError, RecordError, StepGapError) as error:
        raise InputError(f"nominal.file: {message_of(error)}") from None


def _read_surrogate(path: Path, space: StepSpace) -> SurrogateMap:
    try:
        return surrogate_from_dict(space, json.loads(path.read_text("utf-8")))
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"{path}: not the surrogate of a simulator with this state and command ({error})") from None

"""The nominal map of an experiment: one of the robot's, a simulator's surrogate, a template, or one fitted to a log."""

import json
import signal
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from time import perf_counter, process_time
from typing import NamedTuple

import numpy as np

from stepgap.base.errors import InputError, StepGapError, message_of
from stepgap.base.files import read_bounded_text
from stepgap.base.random_streams import random_stream
from stepgap.base.start_method import process_context
from stepgap.control.reference import Reference
from stepgap.experiment.inputs import load_reference
from stepgap.experiment.settings import FROM_LOG, FROM_TEMPLATE, LARGEST_NOMINAL_FILE, Experiment, weighted_space
from stepgap.records.steps_csv import RecordError, read_step_log
from stepgap.robots.nominal_maps.affine_map import AffineMap
from stepgap.robots.nominal_maps.differenced_map import has_no_formula, with_suitable_step
from stepgap.robots.nominal_maps.linearised_map import linearised
from stepgap.robots.nominal_maps.log_map import LogMap, fit_log_map
from stepgap.robots.nominal_maps.simulator import SimulatorMap
from stepgap.robots.nominal_maps.surrogate_map import MapFunction, SurrogateMap, fit_surrogate, surrogate_from_dict
from stepgap.robots.nominal_maps.template_file import gaps_of_template, read_template
from stepgap.robots.nominal_maps.weighted_map import with_space
from stepgap.robots.robot import Robot
from stepgap.step import Array, Outcome, StepFailed, StepMap, StepSpace, StepStatus

WORTH_PROCESSES = 0.02
"""Duration of a simulated step [s] from which several processes sample a simulator; they start in seconds."""

SLOW = 0.004
"""CPU time of a step [s] from which on a map delays a run, which has hundreds of commands, each of tens of steps."""

FEW_EVALUATIONS = 15
"""Number of steps that the choice of a command evaluates on a smooth map that reaches the target."""

TIMED_STEPS = 3  # Number of steps whose duration is measured


USELESS = 0.5
"""Error of a surrogate from which on it predicts no better than the middle of the range of use [half ranges]."""


class Nominal(NamedTuple):
    """A nominal map.

    Attributes:
        map: The map.
        surrogate: The surrogate of a simulator, if it was fitted now.
        warnings: Sentences on what may be wrong with it.
    """

    map: StepMap
    surrogate: SurrogateMap | None = None
    warnings: tuple[str, ...] = ()

    @property
    def file(self) -> str:
        """Text of the file from which the surrogate can be read again; empty if none was fitted."""
        return json.dumps(self.surrogate.to_dict()) + "\n" if self.surrogate else ""


def load_nominal(
    settings: Experiment,
    on_samples: Callable[[int, Array], None] = lambda count, error: None,
    reference: Reference | None = None,
) -> Nominal:
    """The nominal map of an experiment, linearised if the settings want it.

    That of a simulator is a surrogate, which takes seconds to minutes to fit.

    Args:
        on_samples: Called with the number of simulated steps so far, and the error of the surrogate [state units].
        reference: Reference about which the map may be linearised; None for that of the settings.

    Raises:
        InputError: There is no such map, its file is not valid, or it cannot be linearised.
    """
    nominal = _load_map(settings, on_samples)
    if not settings.nominal.linear:
        return nominal
    target = (reference or load_reference(settings, settings.space)).mean_target
    try:
        return nominal._replace(map=linearised(nominal.map, target))
    except StepFailed as error:
        raise InputError(
            f"nominal.linear = true: nominal map '{settings.nominal.kind}' makes no step from the mean target of the "
            f"reference ({error}); choose targets from which it steps"
        ) from None


def _load_map(settings: Experiment, on_samples: Callable[[int, Array], None]) -> Nominal:
    kind = settings.nominal.kind
    file = settings.nominal.file
    robot = settings.robot
    if kind in (FROM_TEMPLATE, FROM_LOG):
        if settings.nominal.surrogate:
            raise InputError(f"nominal.surrogate = true: a map of kind '{kind}' is fast; leave it out")
        if not file:
            example = "template.toml" if kind == FROM_TEMPLATE else "steps.csv"
            raise InputError(f"nominal.kind = {kind}: give its file by nominal.file, such as {example}")
        read = _read_map(kind, Path(file), settings.space)
        if isinstance(read, LogMap):
            return Nominal(read, warnings=tuple(f"{file}: {gap}" for gap in read.gaps))
        return Nominal(read, warnings=gaps_of_template(Path(file), read) if isinstance(read, AffineMap) else ())
    maps = robot.nominal_maps()
    if kind not in maps:
        kinds = ", ".join([*maps, FROM_TEMPLATE, FROM_LOG])
        raise InputError(f"nominal.kind = {kind}: robot '{robot.name}' has no such map; it must be one of {kinds}")
    nominal = maps[kind]()
    if not isinstance(nominal, SimulatorMap) and not settings.nominal.surrogate:
        if file:
            raise InputError(f"nominal.file = {file}: nominal map '{kind}' needs no file")
        read = _differenced(kind, nominal) if has_no_formula(nominal) else Nominal(nominal)
        return read._replace(map=_weighted(read.map, settings))
    if file:
        return Nominal(_read_map(kind, Path(file), settings.space))
    rng = random_stream(settings.seed, 0, 2)
    with _on_all_cores(robot, kind, nominal) as mapped:
        surrogate = fit_surrogate(nominal, rng, mapped, on_samples)
    return Nominal(_weighted(surrogate, settings), surrogate)


def _differenced(kind: str, nominal: StepMap) -> Nominal:
    """A map whose derivatives are differences, with a step that suits it, whatever the seed of the experiment."""
    chosen, rough = with_suitable_step(nominal, random_stream(0, 0, 2))
    advice = "locate its events exactly, or set nominal.surrogate = true, by which a smooth surrogate is fitted to it"
    return Nominal(chosen, warnings=(f"nominal map '{kind}' {rough}; {advice}",) if rough else ())


def _weighted(nominal: StepMap, settings: Experiment) -> StepMap:
    return with_space(nominal, weighted_space(nominal.space, settings.weights))


def check_surrogate(surrogate: SurrogateMap) -> None:
    """Raises InputError if the error of a surrogate is that of a guess."""
    parts = surrogate.error / surrogate.space.state_scale
    wrong = [
        f"{quantity.name} {part:.2g}"
        for quantity, part in zip(surrogate.space.state, parts, strict=True)
        if part > USELESS
    ]
    if wrong:
        status = surrogate.samples.status
        raise InputError(
            f"the surrogate of the simulator predicts {', '.join(wrong)} half ranges wrongly (leave-one-out; at most "
            f"{USELESS:g} is permitted), and {np.count_nonzero(status != StepStatus.OK)} of its {len(status)} "
            "simulated steps failed: the ranges of use contain states from which the robot does not step. Narrow them "
            "to states of its gait (`stepgap check` shows those that it visits), or fit the map to recorded steps: "
            "nominal.kind = log"
        )


def slowness(kind: str, nominal: StepMap, evaluations: int) -> str:
    """A sentence on a map that is so slow that it delays a run; empty for others.

    Args:
        kind: Its name.
        evaluations: Largest number of steps that the choice of a command evaluates (`ControlSettings.evaluations`).
    """
    seconds = _seconds_per_step(nominal, process_time)
    if seconds <= SLOW:
        return ""
    few = min(FEW_EVALUATIONS, evaluations)
    return (
        f"nominal map '{kind}' takes {1e3 * seconds:.0f} ms of CPU time for a step, and the choice of a command "
        f"evaluates {few} steps, in difficult cases up to {evaluations} (control.evaluations), so it takes "
        f"{few * seconds:.2g} to {evaluations * seconds:.0f} s; --nominal.surrogate true fits a fast surrogate to it"
    )


def _seconds_per_step(nominal: StepMap, clock: Callable[[], float]) -> float:
    """Shortest of some durations of a step by a clock [s]."""
    centre = (nominal.space.state_centre, nominal.space.command_centre)
    durations = []
    for _ in range(TIMED_STEPS):
        begin = clock()
        nominal.evaluate(*centre)
        durations.append(clock() - begin)
    return min(durations)


@contextmanager
def _on_all_cores(robot: Robot, kind: str, nominal: StepMap) -> Iterator[MapFunction]:
    """The function with which samples are computed: by processes that each make the map, if one step takes long.

    Another process does not find a robot of a notebook or of a script.
    """
    if type(robot).__module__ == "__main__" or _seconds_per_step(nominal, perf_counter) < WORTH_PROCESSES:
        yield map
        return
    with ProcessPoolExecutor(initializer=_keep_map, initargs=(robot, kind), mp_context=process_context()) as pool:
        yield lambda _, states, commands: pool.map(_evaluate, states, commands)


_kept: list[StepMap] = []
"""The map of this process, if it computes samples for another one; a pool passes no state to its calls otherwise."""


def _keep_map(robot: Robot, kind: str) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the process that waits
    _kept[:] = [robot.nominal_maps()[kind]()]


def _evaluate(states: Array, commands: Array) -> Outcome:
    return _kept[0].evaluate(states, commands)


def _read_map(kind: str, path: Path, space: StepSpace) -> StepMap:
    try:
        if kind == FROM_TEMPLATE:
            return read_template(path, space)
        if kind == FROM_LOG:
            return _log_map(path, space)
        return _read_surrogate(path, space)
    except (OSError, RecordError, StepGapError) as error:
        raise InputError(f"nominal.file: {message_of(error)}") from None


def _log_map(path: Path, space: StepSpace) -> StepMap:
    log = read_step_log(path, space)
    try:
        return fit_log_map(log)
    except StepGapError as error:
        raise InputError(f"{path}: {error}") from None


def _read_surrogate(path: Path, space: StepSpace) -> SurrogateMap:
    try:
        return surrogate_from_dict(space, json.loads(read_bounded_text(path, LARGEST_NOMINAL_FILE)))
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"{path}: not the surrogate of a simulator with this state and command ({error})") from None

"""Why a run did not track, as far as its steps show it, and what to type next: the first lines of a report.

The causes are those of this run alone. They stand in the order in which they are best mended, since one hides those
after it: a robot that does not respond has no reachable targets.
"""

from collections.abc import Iterator
from itertools import chain, islice
from shlex import quote
from typing import Final, NamedTuple

import numpy as np

from stepgap.base.errors import InputError
from stepgap.control.reference import SETTLING_STEPS, same_target
from stepgap.experiment.bands import rmse_interval
from stepgap.experiment.outcome import offset_sentences
from stepgap.experiment.run import Run
from stepgap.experiment.settings import Experiment, with_settings
from stepgap.experiment.settings_text import described_settings
from stepgap.learning.observations import observe
from stepgap.learning.steps import Steps
from stepgap.records.missing import Missing
from stepgap.records.text import listed
from stepgap.report.diagnosis_sentences import (
    OFFSET_ADVICE,
    OFTEN,
    bound_sentences,
    parts_at_bounds,
    response_sentences,
)
from stepgap.report.verdict import Achievement, clear_change
from stepgap.step import Array, Quantity

MOST_REASONS: Final = 3  # A reader acts on the first one

_JUMP: Final = 0.2  # Part of its range by which a command changes, at an unchanged target, from which on it jumps
_JUMPING: Final = 0.25  # Part of the steps in which it does so

_FEWEST_JUMPS: Final = 10  # Smallest number of steps at unchanged targets that show it
_LATE: Final = 3.0  # Ratio of errors after a change of the target to those later from which on they are a cause
_WORSE: Final = 1.5  # Ratio of the error after learning to that before from which on learning is a cause
_MANY_CUT: Final = 0.1  # Part of the steps from which on cut commands are a cause


class Reason(NamedTuple):
    """A cause.

    Attributes:
        sentence: What the steps of the run show.
        advice: What to do next, in words.
        command: What to type for it; empty if there is no such command.
    """

    sentence: str
    advice: str
    command: str = ""


def reasons(run: Run) -> list[Reason]:
    """The first causes of the errors of a run: none if it tracked, and its commands do not jump.

    A decisive one stands alone, because it would explain the others.
    """
    if not run.deployments:
        return []
    achieved = Achievement(run)
    last = run.steps.of_iteration(achieved.last.iteration).tracking()
    jumps = list(_jumps(run, last))
    if not achieved.last.failed_steps and not achieved.far_rows and not _is_worse(run, achieved):
        return jumps
    for decisive in (_known_before, _too_weak, _response, _worse):
        if causes := list(decisive(run, achieved)):
            return causes[:MOST_REASONS]
    reach = list(_reach(run, achieved))
    others = [] if reach else jumps  # between two bounds a command jumps
    possible = chain(reach, _changes(run, achieved), others, _goes_on(run, achieved))
    return list(islice(possible, MOST_REASONS))


def changes_at_constant_targets(steps: Steps) -> Array:
    """Changes of the commands from a step to the next one with the same target, as parts of their ranges; (k, m)."""
    held = steps.follows[1:] & same_target(steps.target[1:], steps.target[:-1])
    return np.abs(np.diff(steps.requested, axis=0))[held] / (2 * steps.space.command_scale)


def _with_settings(verb: str, run: Run, options: str = "") -> str:
    """The command that calls a verb with the settings of a run, and with other ones."""
    return f"stepgap {verb} {quote(str(run.folder / 'experiment.toml'))} {options}".rstrip()


def _with_target(run: Run, achieved: Achievement, state: Array) -> str:
    """The command that runs again with one target for all steps, the tracked coordinates of a state (n,)."""
    target = ",".join(f"{run.space.state_names[row]}={state[row]:.3g}" for row in achieved.rows)
    return _with_settings("run", run, f"--target {target}")


def _response(run: Run, achieved: Achievement) -> Iterator[Reason]:
    """Coordinates that do not follow the commands, or stay on one side of all targets."""
    first = run.steps.of_iteration(run.steps.iterations[0])
    check = _with_settings("check", run)
    if not isinstance(run.nominal, Missing):
        for sentence in response_sentences(first, run.nominal):
            yield Reason(sentence, "The test of the robot says which part of it to mend.", check)
    if offsets := offset_sentences(run.steps.of_iteration(run.steps.iterations[-1])):
        yield Reason(" ".join(offsets), OFFSET_ADVICE, check)


def _too_weak(run: Run, achieved: Achievement) -> Iterator[Reason]:
    """Drives that cannot do the targets."""
    last = run.steps.of_iteration(run.steps.iterations[-1])
    offsets = offset_sentences(last)
    if not offsets or achieved.last.cut <= _MANY_CUT * achieved.last.steps:
        return
    cut = f"Limits of the drives cut {achieved.last.cut} of {achieved.last.steps} commands of the last deployment."
    advice = "The robot is too weak for these targets: choose others near what it did, or stronger drives."
    yield Reason(" ".join([cut, *offsets]), advice, _with_target(run, achieved, np.nanmedian(last.next_state, axis=0)))


def _known_before(run: Run, achieved: Achievement) -> Iterator[Reason]:
    """Earlier steps that predict the first deployment worse than the nominal map does."""
    first = run.steps.of_iteration(run.steps.iterations[0]).tracking().completed()
    if run.summary.warm_start is None or isinstance(run.nominal, Missing) or not len(first):
        return
    scale = run.space.state_scale
    errors = np.array([first.next_state - first.predicted, observe(first, run.nominal).error]) / scale
    learned, nominal = np.sqrt(np.nanmean(errors**2, axis=(1, 2)))
    if learned > nominal:
        sentence = (
            f"The {run.summary.warm_start.steps} steps known before the run predict its first deployment "
            f"{learned / nominal:.2g} times worse than the nominal map: they are of another robot."
        )
        yield Reason(sentence, "Begin without them.", _with_settings("run", run, "--warm-start none"))


def _is_worse(run: Run, achieved: Achievement) -> bool:
    """Whether the robot fell, or did clearly worse, with what was learned, but not with the nominal map."""
    first = achieved.first
    last = achieved.last
    if achieved.predicted or not achieved.learned or first.failed_steps:
        return False
    scale = run.space.state_scale[achieved.rows]
    before, after = (np.linalg.norm(one.rmse[achieved.rows] / scale) for one in (first, last))
    return bool(last.failed_steps or after > _WORSE * before)


def _worse(run: Run, achieved: Achievement) -> Iterator[Reason]:
    """A robot that did worse with what was learned than with the nominal map: by commands that jump, or otherwise."""
    if not _is_worse(run, achieved):
        return
    first = achieved.first
    last = run.steps.of_iteration(achieved.last.iteration).tracking()
    if jumps := list(_jumps(run, last)):
        yield from jumps
        return
    sentence = (
        f"Deployment {first.iteration} made all its {first.steps} steps with the nominal map, and what was learned "
        "from them made it worse: the error of this robot may jump, as where a foot slips or a limit acts."
    )
    advice = "Changes of the target that are smaller stay clear of jumps: first try one target amid these."
    yield Reason(sentence, advice, _with_target(run, achieved, np.nanmean(last.target, axis=0)))


def _reach(run: Run, achieved: Achievement) -> Iterator[Reason]:
    """Targets that no command holds, and commands at their bounds."""
    space = run.space
    last = achieved.last
    steps = run.steps.of_iteration(last.iteration)
    bounds = bound_sentences(steps)
    if not len(last.unreachable) and bounds and (wider := _wider_bounds(run, steps)):
        advice = "If the robot can stand larger commands, wider bounds show whether they are the cause."
        yield Reason(" ".join(bounds), advice, _with_settings("run", run, wider))
        return
    names = [space.state_names[row] for row in achieved.rows]
    if len(last.unreachable):
        count = len(np.unique(steps.tracking().target, axis=0))
        sentence = f"By what was learned, no command holds {len(last.unreachable)} of {count} targets."
    elif bounds:
        sentence = " ".join(bounds)
    else:
        return
    if len(names) > 1 and last.failed_steps == 0:
        worst = space.state_names[max(achieved.rows, key=lambda row: achieved.parts[row])]
        better = [name for name in names if name != worst]
        advice = f"Track {listed(better)} alone, to see whether {worst} is what asks too much; or widen the bounds."
        yield Reason(sentence, advice, _with_settings("run", run, f"--weights.{worst} 0"))
        return
    advice = "Choose targets nearer to the middle, or wider bounds; a figure shows the set that one step can reach."
    yield Reason(sentence, advice, _with_settings("gait", run))


def _wider_bounds(run: Run, steps: Steps) -> str:
    """Options with which commands that were often at a bound have twice their range; empty if no setting has it."""
    settings = run.settings
    if isinstance(settings, Missing):
        return ""
    options = []
    for row, part in enumerate(parts_at_bounds(steps).tolist()):
        command = settings.space.command[row]
        half = (command.upper - command.lower) / 2
        wider = {command.lower: command.lower - half, command.upper: command.upper + half} if part > OFTEN else {}
        for name, _, value in described_settings(settings):
            if isinstance(value, float) and value in wider:
                changed = _command_with(settings, name, wider[value], row)
                if changed.lower < command.lower or changed.upper > command.upper:
                    options.append(f"--{name}={wider[value]:.4g}")
    return " ".join(options)


def _command_with(settings: Experiment, name: str, value: float, row: int) -> Quantity:
    """A coordinate of the command with another value of a setting; as it is if that is refused."""
    try:
        return with_settings(settings, [(name, repr(value))]).space.command[row]
    except InputError:
        return settings.space.command[row]


def _changes(run: Run, achieved: Achievement) -> Iterator[Reason]:
    """Changes of the target that one step cannot make."""
    last = achieved.last
    late = [row for row in achieved.far_rows if last.transient_rmse[row] > _LATE * last.steady_rmse[row]]
    if late:
        names = listed([run.space.state_names[row] for row in late])
        sentence = f"The errors of {names} are mostly those of the {SETTLING_STEPS} steps after a change of the target."
        advice = "Let the controller plan several steps, or change the target in smaller steps."
        yield Reason(sentence, advice, _with_settings("run", run, "--control.horizon 4"))


def _jumps(run: Run, last: Steps) -> Iterator[Reason]:
    """Commands that jump although the target stays the same, as where two of them do equally well."""
    changes = changes_at_constant_targets(last)
    if len(changes) < _FEWEST_JUMPS:
        return
    often = np.quantile(changes, 1 - _JUMPING, axis=0)
    names = [name for name, change in zip(run.space.command_names, often, strict=True) if change > _JUMP]
    if names:
        sentence = (
            f"At an unchanged target, {listed(names)} changes by {100 * often.max():.0f} % of its range or more in "
            "every fourth step."
        )
        advice = (
            "Other commands do about equally well, or a command also acts in the step after it: a limit of its change "
            "calms it."
        )
        yield Reason(sentence, advice, _with_settings("run", run, "--control.largest_change 0.1"))


def _goes_on(run: Run, achieved: Achievement) -> Iterator[Reason]:
    """Errors that were still becoming smaller, or of a robot of which nothing was learned yet."""
    further = f"stepgap run --out {quote(str(run.folder))} --extend 2"
    if not achieved.learned:
        yield Reason("Nothing was learned yet.", "Let it learn from these steps in further deployments.", further)
        return
    if len(run.deployments) < 2 or achieved.last.failed_steps:
        return
    before, after = run.deployments[-2:]
    intervals = [rmse_interval(run.steps.of_iteration(entry.iteration)) for entry in (before, after)]
    for row in achieved.far_rows:
        ends = np.array([interval[:, row] for interval in intervals])
        if before.rmse[row] > 0 and after.rmse[row] > 0 and clear_change(before.rmse[row], after.rmse[row], ends) < 0:
            sentence = f"The error still became smaller from deployment {before.iteration} to {after.iteration}."
            yield Reason(sentence, "Let it go on learning.", further)
            return

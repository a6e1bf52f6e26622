"""Why a run did not track, as far as its steps show it, and what to type next: the first lines of a report.

The causes are those of this run alone. They stand in the order in which they are best mended, since one hides those
after it: a robot that does not respond has no reachable targets.
"""

from collections.abc import Iterator
from itertools import chain, islice
from shlex import quote
from typing import Final, NamedTuple

import numpy as np

from stepgap.control.reference import SETTLING_STEPS, same_target
from stepgap.experiment.bands import rmse_interval
from stepgap.experiment.outcome import offset_sentences
from stepgap.experiment.run import Run
from stepgap.learning.observations import observe
from stepgap.learning.steps import Steps
from stepgap.records.missing import Missing
from stepgap.records.text import capitalised, listed
from stepgap.report.diagnosis_sentences import OFFSET_ADVICE, bound_sentences, response_sentences
from stepgap.report.verdict import Achievement, clear_change
from stepgap.step import Array

MOST_REASONS: Final = 3  # A reader acts on the first one

_JUMP: Final = 0.2
"""Part of its range by which a command changes in the median, at an unchanged target, from which on it jumps."""

_FEWEST_JUMPS: Final = 10  # Smallest number of steps at unchanged targets that show it
_LATE: Final = 3.0  # Ratio of errors after a change of the target to those later from which on they are a cause
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
    """The first causes of the errors of a run: none if it tracked, and its commands do not jump."""
    if not run.deployments:
        return []
    achieved = Achievement(run)
    last = run.steps.of_iteration(achieved.last.iteration).tracking()
    jumps = list(_jumps(run, last))
    if not achieved.last.failed_steps and not achieved.far_rows:
        return jumps
    possible = chain(
        _response(run),
        _known_before(run),
        _reach(run, achieved),
        _cut(run, achieved),
        _changes(run, achieved),
        jumps,
        _goes_on(run, achieved),
    )
    return list(islice(possible, MOST_REASONS))


def changes_at_constant_targets(steps: Steps) -> Array:
    """Changes of the commands from a step to the next one with the same target, as parts of their ranges; (k, m)."""
    held = steps.follows[1:] & same_target(steps.target[1:], steps.target[:-1])
    return np.abs(np.diff(steps.requested, axis=0))[held] / (2 * steps.space.command_scale)


def _with_settings(verb: str, run: Run, options: str = "") -> str:
    """The command that calls a verb with the settings of a run, and with other ones."""
    return f"stepgap {verb} {quote(str(run.folder / 'experiment.toml'))} {options}".rstrip()


def _response(run: Run) -> Iterator[Reason]:
    """Coordinates that do not follow the commands, or stay on one side of all targets."""
    first = run.steps.of_iteration(run.steps.iterations[0])
    check = _with_settings("check", run)
    if not isinstance(run.nominal, Missing):
        for sentence in response_sentences(first, run.nominal):
            yield Reason(sentence, "The test of the robot says which part of it to mend.", check)
    for sentence in offset_sentences(run.steps.of_iteration(run.steps.iterations[-1])):
        yield Reason(sentence, OFFSET_ADVICE, check)


def _known_before(run: Run) -> Iterator[Reason]:
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
        advice = "Begin without them: leave out --warm-start, or the line warm_start from the settings."
        yield Reason(sentence, advice)


def _reach(run: Run, achieved: Achievement) -> Iterator[Reason]:
    """Targets that no command holds, and commands at their bounds."""
    space = run.space
    last = achieved.last
    steps = run.steps.of_iteration(last.iteration)
    bounds = bound_sentences(steps)
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


def _cut(run: Run, achieved: Achievement) -> Iterator[Reason]:
    last = achieved.last
    if last.cut > _MANY_CUT * last.steps:
        sentence = f"Limits of the drives cut {last.cut} of {last.steps} commands of deployment {last.iteration}."
        yield Reason(sentence, "Choose slower or lower targets, or stronger drives: learning cannot make up for this.")


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
    median = np.median(changes, axis=0)
    names = [name for name, change in zip(run.space.command_names, median, strict=True) if change > _JUMP]
    if names:
        sentence = (
            f"{listed(names)}: at an unchanged target, the command jumps by {100 * median.max():.0f} % of its range "
            "from a step to the next, in the median."
        )
        advice = "Other commands do about equally well: a limit of its change keeps to one of them."
        yield Reason(capitalised(sentence), advice, _with_settings("run", run, "--control.largest_change 0.1"))


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

"""The command line of the learning benchmark: `./go python -m benchmarks.learning`."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import App, Parameter, validators

from stepgap.base.errors import InputError, StepGapError
from stepgap.cli.app import main
from stepgap.cli.help_format import HelpFormat
from stepgap.cli.options import Flag, Integer, Name, Names
from stepgap.cli.terminal import announces_compilation
from stepgap.sweep.cli.execution import THIS_MACHINE, Execution, all_finished, computed_cases

if TYPE_CHECKING:  # slow imports are made where they are used
    from collections.abc import Sequence

    from benchmarks.learning.learning_plan import LearningPlan, LearningResults
    from stepgap.sweep.cases.case_folder import CaseFolder

Count = Annotated[Integer, Parameter(validator=validators.Number(gte=1, lte=1000))]
"""Number of repetitions."""

DEFAULT_TWINS, DEFAULT_SEEDS = 20, 3
"""Number of random twins, and of seeds of each twin."""


@announces_compilation
def compare_methods(
    *,
    twins: Count | None = None,
    seeds: Count | None = None,
    methods: Names | None = None,
    task: Name | None = None,
    quick: Flag = False,
    out: Path = Path("bench_learning"),
    execution: Execution = THIS_MACHINE,
) -> None:
    """Compare ways to learn on random twins: errors, hops needed, failed steps, intervals; some hours of one core.

    Args:
        twins: Number of random twins. [default: 20]
        seeds: Number of seeds of each twin. [default: 3]
        methods: Names of the methods, as NAME,NAME; METHOD-RULE is a method without a rule, such as
            posterior-drift. [default: all, each with all its rules]
        task: What the robot is to do: reference, payload, torque_limit, square or rough. [default: reference]
        quick: Take half a minute: 2 twins, 1 seed, and only the methods linear and posterior.
        out: Folder for the measurements, their summary and the figure. With --resume, also twins, seeds, methods and
            task are those in it, unless they are given.
    """
    from benchmarks.learning.learning_plan import measure_case

    plan = _plan_in_folder(out, execution) if not (twins or seeds or methods or task or quick) else None
    plan = plan or _new_plan(twins, seeds, methods, task, quick)
    with computed_cases(out, plan, measure_case, execution, "python -m benchmarks.learning") as cases:
        if all_finished(plan, cases, execution.quiet):
            _summarise(plan, cases, execution.quiet)


def _plan_in_folder(out: Path, execution: Execution) -> "LearningPlan | None":
    """The plan in a folder that is continued; None if there is none."""
    from benchmarks.learning.learning_plan import LEARNING_FILE, read_learning_plan

    file = out / LEARNING_FILE
    if not execution.resume or not file.is_file():
        return None
    plan = read_learning_plan(file)
    _check_methods(plan.methods, f"{file}: methods")
    return plan


def _new_plan(
    twins: int | None, seeds: int | None, methods: str | None, task: str | None, quick: bool
) -> "LearningPlan":
    from benchmarks.learning.learning_plan import LearningPlan
    from benchmarks.learning.methods.registry import QUICK, default_methods
    from benchmarks.learning.tasks import DEFAULT_TASK, tasks
    from stepgap.control.reference import reference_text

    chosen = methods.split(",") if methods else QUICK if quick else default_methods()
    _check_methods(chosen, "--methods")
    known, name = tasks(), task or DEFAULT_TASK
    if name not in known:
        raise InputError(f"--task {name}: it must be one of {', '.join(known)}")
    size = (2, 1) if quick else (twins or DEFAULT_TWINS, seeds or DEFAULT_SEEDS)
    return LearningPlan(*size, tuple(chosen), reference_text(known[name].reference), name)


def _check_methods(chosen: "Sequence[str]", source: str) -> None:
    """Raises InputError if a method is unknown."""
    from benchmarks.learning.methods.ablation import ABLATIONS
    from benchmarks.learning.methods.registry import is_method
    from benchmarks.learning.methods.registry import methods as known_methods

    if unknown := [name for name in chosen if not is_method(name)]:
        names = f"it must be one of {', '.join(known_methods())}; also METHOD-RULE with one of {', '.join(ABLATIONS)}"
        raise InputError(f"{source} {unknown[0]}: {names}")


def _summarise(plan: "LearningPlan", folder: "CaseFolder", quiet: bool) -> None:
    """Prints the table, writes all rows, their summary and the figure, and prints the paths of the files."""
    from benchmarks.learning.learning_figure import learning_picture
    from benchmarks.learning.learning_plan import learning_results
    from benchmarks.learning.learning_summary import describe_learning, summarise_learning
    from stepgap.base.files import write_whole

    results = learning_results(plan, folder)
    if not results.rows:
        reason = next(iter(results.failed.values()))
        raise StepGapError(f"{folder.path}: all {len(plan)} cases failed, the first one: {reason}")
    summary = summarise_learning(results.rows)
    if not quiet:
        print("\n".join([describe_learning(summary), *_left_out(plan, results)]))
    files = {
        "results.json": json.dumps(results.rows),
        "summary.json": json.dumps(summary, indent=1),
        "learning.png": learning_picture(results.rows, "png"),
    }
    with folder.alone():
        for name, content in files.items():
            write_whole(folder.path / name, content)
    for name in files:
        print(folder.path / name)


def _left_out(plan: "LearningPlan", results: "LearningResults") -> "list[str]":
    """Lines about cases that are not in the summary."""
    lines = list[str]()
    if results.failed:
        lines.append(f"{len(results.failed)} of {len(plan)} cases failed and are left out:")
    for number, reason in results.failed.items():
        twin, seed = plan.twin_and_seed(number)
        lines.append(f"  twin {twin}, seed {seed}: {reason}")
    return lines


def learning_line(_: str = "") -> App:
    """The command line, which has no verbs."""
    app = App(name="benchmarks.learning", help_format="plaintext", help_formatter=HelpFormat())
    app.default(compare_methods)
    return app


if __name__ == "__main__":
    main(verbs=learning_line)

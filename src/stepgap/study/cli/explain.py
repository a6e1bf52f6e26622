"""The verb `stepgap explain`."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from stepgap.base.errors import InputError
from stepgap.base.output_files import PICTURE_FORMATS, check_new, format_by_name, write_new
from stepgap.cli.options import Flag, Integer, NamedValues, Names
from stepgap.cli.terminal import announces_compilation, print_table
from stepgap.robots.gap import Gap, differences

if TYPE_CHECKING:  # slow imports are made where they are used
    from stepgap.study.explanation import Cause
    from stepgap.study.simulated_errors import SimulatedRobots

LEAST_PER_MONOMIAL = 2
"""Number of completed steps, for each monomial of the errors' polynomial, from which a run says something."""


@announces_compilation
def explain(
    run: Path,
    /,
    *,
    causes: Names | None = None,
    known: NamedValues | None = None,
    seed: Integer = 0,
    out: Path | None = None,
    quiet: Flag = False,
) -> None:
    """Explain the error of a run: which differences from the model the robot may have, of what size, and what is left.

    Two robots with each difference alone are simulated, on all cores, which takes up to some minutes.

    Args:
        run: Folder of the run.
        causes: Differences that are possible, as keys of the table gap; by default all that are not known.
        known: Differences that the robot certainly has, as keys of the table gap with their values, such as the
            resolution of its encoders.
        seed: Random seed of the simulations.
        out: New file: a page (.html), or the figure alone (.png, .pdf or .svg).
        quiet: Show no progress.
    """
    from stepgap.cli.progress import progress_bar
    from stepgap.experiment.run import Run
    from stepgap.experiment.settings_text import meanings
    from stepgap.gauss.monomials import number_of_monomials
    from stepgap.learning.observations import observe
    from stepgap.report.drawing import write_picture
    from stepgap.study.explanation import SIGNATURE_DEGREE, RunError, explain_error
    from stepgap.study.explanation_page import (
        explanation_figure,
        explanation_page,
        explanation_sentences,
        explanation_table,
    )
    from stepgap.study.simulated_errors import SimulatedRobots, gap_of, simulated_on_all_cores, targets_of

    if not 0 <= seed < 2**63:
        raise InputError(f"--seed {seed}: it must lie between 0 and 2⁶³")
    if out:
        check_new(out, "--out")
    form = format_by_name(out, ("html", *PICTURE_FORMATS)) if out else ""
    opened = Run(run).checked()
    settings = opened.needed(opened.settings)
    gap = gap_of(settings)
    steps = observe(opened.recorded, opened.needed(opened.nominal))
    needed = LEAST_PER_MONOMIAL * number_of_monomials(len(steps.space.names), SIGNATURE_DEGREE)
    if len(steps) < needed:
        raise InputError(f"{run}: {len(steps)} completed steps say too little; {needed} are needed")
    robots = SimulatedRobots(settings, targets_of(steps), seed, _known(known, gap))
    chosen = _chosen(causes, robots)
    total = 2 + 2 * len(chosen)  # a few more where robots fall
    with (
        progress_bar("simulated robots", quiet) as progress,
        simulated_on_all_cores(robots, lambda done: progress(min(done, total), total)) as simulate,
    ):
        explanation = explain_error(RunError.of(steps), chosen, simulate)
    for sentence in explanation_sentences(explanation, steps.space):
        print(sentence)
    texts = meanings(type(gap))
    print()
    print_table(*explanation_table(explanation, texts))
    if out and form == "html":
        write_new(out, "--out", explanation_page(opened.folder.resolve().name, explanation, steps.space, texts))
    elif out:
        write_picture(out, lambda: explanation_figure(explanation))


def _chosen(names: str | None, robots: "SimulatedRobots") -> "list[Cause]":
    """The causes of these names.

    Raises:
        InputError: There is no such cause, or none at all.
    """
    possible = {name: cause for name, cause in robots.causes.items() if name not in robots.known}
    if not possible:
        raise InputError("--known: it names all differences, so none can be a cause")
    if names is None:
        return [*possible.values()]
    chosen = [name.strip() for name in names.split(",")]
    for name in chosen:
        if name in robots.known:
            raise InputError(f"--causes {name}: --known says that the robot has it, so it is no possible cause")
        if name not in possible:
            raise InputError(f"--causes {name}: no such cause; it must be one of {', '.join(possible)}")
    return [possible[name] for name in dict.fromkeys(chosen)]


def _known(text: str | None, gap: Gap) -> dict[str, float]:
    """Values of known differences.

    Raises:
        InputError: There is no such difference, or it cannot have this value.
    """
    values = dict[str, float]()
    keys = differences(gap)
    for part in text.split(",") if text is not None else ():
        name, _, number = part.strip().partition("=")
        try:
            if name in values:
                raise ValueError("each can have one value")
            if name not in keys:
                raise ValueError("no such difference")
            values[name] = float(number)
        except ValueError as error:
            names = ", ".join(keys)
            raise InputError(f"--known {part}: {error}; give NAME=VALUE, where NAME is one of {names}") from None
    try:
        replace(type(gap).none(), **values)
    except ValueError as error:
        raise InputError(f"--known {text}: {error}") from None
    return values

"""The verb `stepgap steps`."""

import sys
from collections.abc import Sequence
from dataclasses import fields, make_dataclass
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Annotated, Any, get_type_hints

from cyclopts import Parameter

from stepgap.base.errors import InputError
from stepgap.base.files import read_bounded
from stepgap.base.output_files import check_new, format_by_name, write_together
from stepgap.cli.options import Flag, ListOfNames, Name
from stepgap.logs.sections.section_settings import SectionSettings, read_section_settings

if TYPE_CHECKING:  # slow imports are made where they are used
    from stepgap.logs.sections.step_extraction import ExtractedSteps


def _as_options(settings: type[Any], not_options: Sequence[str]) -> type[Any]:
    """The fields of a dataclass of settings as options, which are None where they are not given."""
    kinds: dict[Any, Any] = {str: Name, tuple[str, ...]: ListOfNames, bool: Flag}
    hints = get_type_hints(settings)
    names = [entry.name for entry in fields(settings) if entry.name not in not_options]
    options = [(name, kinds.get(hints[name], hints[name]) | None, None) for name in names]
    made = make_dataclass(
        "SectionOptions", options, frozen=True, namespace={"__doc__": settings.__doc__, "__module__": __name__}
    )
    return Parameter(name="*")(made)


SectionOptions = _as_options(SectionSettings, ["units", "factors", "format"])
"""`SectionSettings` on the command line."""

_LARGEST_PICTURE = 2**26  # Largest file that may be a figure of this verb [bytes]

NO_OPTIONS = SectionOptions()


def steps(
    *log: str,
    out: Path,
    plan: Annotated[list[Path] | None, Parameter(consume_multiple=True)] = None,
    columns: Path | None = None,
    options: SectionOptions = NO_OPTIONS,  # pyright: ignore[reportInvalidTypeForm]
    plot: Path | None = None,
) -> None:
    """Extract the steps of a robot from logs of its motion: the state at each section, and the command of each step.

    A step is left out if its sections or its command are doubtful. A log is refused if many are.

    Args:
        log: Logs in any format (docs/logs.md); files that belong together are joined as FILE+FILE.
        out: New CSV file for the steps; a file of the same name that ends with .toml is for stepgap fit --columns.
        plan: For each log, the file with a row for each plan; without it, commands are columns of the log.
        columns: TOML file with the options from here on, and with units and factors of columns.
        plot: New figure of all sections, and of each doubtful one. [default: as --out, but .png]
    """
    from stepgap.logs.sections.step_extraction import extract_deployments
    from stepgap.logs.sections.steps_table import columns_toml, describe_steps, steps_table

    if not log:
        raise InputError("LOG: none given; give logs of the robot's motion, such as log.csv or state.csv+encoder.csv")
    if plan and len(plan) != len(log):
        raise InputError(f"--plan: {len(plan)} files for {len(log)} logs; give one for each, in the same order")
    given = {name: value for name, value in vars(options).items() if value is not None}
    settings = read_section_settings(columns, given)
    picture = plot or out.with_suffix(".png")
    meaning = out.with_suffix(".toml")
    _check_outputs(out, meaning, picture)
    deployments: list[ExtractedSteps] = []
    for number, text in enumerate(log):
        for deployment in extract_deployments(text, plan[number] if plan else None, settings):
            deployments.append(deployment)
            print(describe_steps(deployment), flush=True)
    if refusals := [deployment.refusal for deployment in deployments if deployment.refusal]:
        write_together(_drawn(deployments, picture), "--plot")
        raise InputError(f"{'; '.join(refusals)}. {picture} shows them; nothing else was written")
    text = columns_toml(deployments[0], settings)
    tables = {out: steps_table(deployments), **({meaning: text} if text else {})}
    write_together({**tables, **_drawn(deployments, picture)}, "--out")
    if text:
        typed = (quote(f"./{path}" if str(path).startswith("-") else str(path)) for path in (out, meaning))
        print(f"stepgap fit {' --columns '.join(typed)} shows what can be learned from these steps", file=sys.stderr)
    else:
        print("without --command or --target, stepgap fit cannot use these steps", file=sys.stderr)


def _check_outputs(out: Path, meaning: Path, picture: Path) -> None:
    """Raises InputError if one of the files cannot be written."""
    if out.suffix in (".toml", ".png"):
        raise InputError(f"{out}: the name must end with .csv")
    format_by_name(picture)
    for file in (out, meaning):
        check_new(file, "--out")
    if not _is_of_refused(picture):
        check_new(picture, "--plot")


def _is_of_refused(picture: Path) -> bool:
    """Whether a file is the figure of a log that was refused, which the figure of the next command replaces."""
    from stepgap.logs.sections.steps_table import REFUSED

    if picture.is_symlink() or not picture.is_file():
        return False
    try:
        return REFUSED.encode() in read_bounded(picture, _LARGEST_PICTURE)
    except (OSError, InputError):
        return False


def _drawn(deployments: "list[ExtractedSteps]", picture: Path) -> dict[Path, bytes]:
    """The figure, as the content of its file, in whose place there is no longer that of a refused log."""
    from stepgap.report.own_style import own_style

    with own_style():
        from stepgap.logs.sections.section_figures import sections_picture

        content = sections_picture(deployments, picture.suffix[1:].lower())
    if _is_of_refused(picture):
        picture.unlink()
    return {picture: content}

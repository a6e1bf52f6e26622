"""The verb `stepgap steps`."""

import sys
from dataclasses import asdict, dataclass
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from stepgap.base.errors import InputError
from stepgap.base.output_files import check_new, format_by_name, write_new, write_together
from stepgap.cli.options import Flag, Name, Names, Seconds

if TYPE_CHECKING:  # slow imports are made where they are used
    from stepgap.logs.sections.step_extraction import ExtractedSteps


@Parameter(name="*")
@dataclass(frozen=True)
class SectionOptions:
    """Sections of a log and the meaning of its columns.

    Attributes:
        state: Coordinates of the state, as speed=rate(COLUMN),height=COLUMN, or vx=mean(COLUMN) for the mean over the
            step before, also vx=mean(rate(COLUMN)).
        command: Coordinates of the command, columns of the plan or of the log.
        target: Coordinates of the target, likewise.
        predicted: Coordinates of the state that the nominal map predicts, likewise.
        time: Column of the time [s]. [default: time, log_time, t or timestamp]
        height: Column of the height. Without the next four options, each of its tops is a section.
        phase: Column of the phase of gait.
        contact: Columns that are 1 where a foot is in contact.
        force: Columns of the force between ground and foot.
        crossing: Column that passes a level at the section.
        every: Time from section to section [s], for commands that hold, such as of velocities: a step begins where the
            command changes, and then at these intervals for as long as it holds.
        hold: How long a command holds if no other one follows [s]. [default: five usual times between two of them]
        aerial: Phases in which the robot is in the air. [default: those with flight, aerial or swing in their names]
        at: Section of a flight: apex, begin (lift-off) or end (touch-down); of walking, next_foot, which is the
            touch-down of another foot than before. [default: apex]
        threshold: Force above which a foot is in contact. [default: 0.3 of the 95th percentile]
        level: Level of the crossing. [default: 0]
        falling: The crossing is downwards.
        rise: Smallest prominence of a top of the height. [default: found]
        window: Time before and after a section from which the state is estimated. [default: found]
        boom: Length [m] of the boom around which the robot hops: adds columns height and forward [m] to the log.
        pitch: Column of the boom's angle above the horizon [rad].
        yaw: Column of the boom's angle about the vertical [rad].
        pose: Columns x,y,yaw or x,y,qx,qy,qz,qw, or a message with a pose, such as pose.pose: adds columns forward,
            left [m] and turn [rad], the motion as the robot sees it.
        plan_time: Column of the time in the plan. [default: as --time]
        plan_match: PLAN_COLUMN=COLUMN, for a plan without times: its row is of the time at which both are equal.
        of_several: The command that counts if a step has several. [default: such a step is left out]
        delay: Time that is added to those of the commands [s], where the clocks of two recordings differ.
        deployment: Column that separates deployments, such as an episode: each is a log of its own.
    """

    state: Names | None = None
    command: Names | None = None
    target: Names | None = None
    predicted: Names | None = None
    time: Name | None = None
    height: Name | None = None
    phase: Name | None = None
    contact: Names | None = None
    force: Names | None = None
    crossing: Name | None = None
    every: Seconds | None = None
    hold: Seconds | None = None
    aerial: Names | None = None
    at: Literal["apex", "begin", "end", "next_foot"] | None = None
    threshold: float | None = None
    level: float | None = None
    falling: Flag = False
    rise: float | None = None
    window: Seconds | None = None
    boom: float | None = None
    pitch: Name | None = None
    yaw: Name | None = None
    pose: Names | None = None
    plan_time: Name | None = None
    plan_match: Name | None = None
    of_several: Literal["first", "last", "largest"] | None = None
    delay: Seconds | None = None
    deployment: Name | None = None

    def given(self) -> dict[str, str | float | bool]:
        """The options that were given."""
        return {name: value for name, value in asdict(self).items() if value is not None and value is not False}


NO_OPTIONS = SectionOptions()


def steps(
    *log: str,
    out: Path,
    plan: Annotated[list[Path] | None, Parameter(consume_multiple=True)] = None,
    columns: Path | None = None,
    options: SectionOptions = NO_OPTIONS,
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
    from stepgap.logs.sections.section_settings import read_section_settings
    from stepgap.logs.sections.step_extraction import extract_deployments
    from stepgap.logs.sections.steps_table import columns_toml, describe_steps, steps_table

    if not log:
        raise InputError("LOG: none given; give logs of the robot's motion, such as log.csv or state.csv+encoder.csv")
    if plan and len(plan) != len(log):
        raise InputError(f"--plan: {len(plan)} files for {len(log)} logs; give one for each, in the same order")
    settings = read_section_settings(columns, options.given())
    picture, meaning = plot or out.with_suffix(".png"), out.with_suffix(".toml")
    _check_outputs(out, meaning, picture)
    found: list[ExtractedSteps] = []
    for number, text in enumerate(log):
        for each in extract_deployments(text, plan[number] if plan else None, settings):
            found.append(each)
            print(describe_steps(each), flush=True)
    if refusals := [each.refusal for each in found if each.refusal]:
        _draw(found, picture)
        raise InputError(f"{'; '.join(refusals)}. {picture} shows them; nothing else was written")
    text = columns_toml(found[0], settings)
    write_together({out: steps_table(found), **({meaning: text} if text else {})}, "--out")
    _draw(found, picture)
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
    check_new(picture, "--plot")


def _draw(found: "list[ExtractedSteps]", picture: Path) -> None:
    from stepgap.report.own_style import own_style

    with own_style():
        from stepgap.logs.sections.section_figures import sections_picture

        write_new(picture, "--plot", sections_picture(found, picture.suffix[1:].lower()))

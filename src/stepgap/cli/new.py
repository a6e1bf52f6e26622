"""The verb `stepgap new`: a folder with a robot that runs at once, to be changed into one's own."""

import json
import sys
from pathlib import Path
from string import Template
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from stepgap.base.errors import InputError, message_of
from stepgap.base.files import create, new_folder
from stepgap.base.output_files import EXISTING_IS_COMPLETE, writing
from stepgap.base.plugins import load_plugin
from stepgap.cli.new_package import EQUATIONS, MUJOCO, check_package_name, readme_name, starter_text, write_package
from stepgap.cli.options import NO_COLUMNS, ColumnNames, Flag
from stepgap.cli.terminal import warn

if TYPE_CHECKING:  # slow imports are made where they are used
    from collections.abc import Callable, Sequence

    from stepgap.learning.steps import Steps
    from stepgap.step import Array, Quantity, StepSpace


STARTERS = "stepgap.starters"
"""Entry points of this group write a robot from files of others: `mjcf` from a model, `policy` from a network, too."""
IMPORTERS = "stepgap.importers"  # Entry points of this group read the steps of logs of other programs
PRACTICE = """\
Until then the robot is for practice only: it jumps to the recorded step that is nearest to state and command, and only
a part of the errors that these jumps cause can be learned."""
"""What the README says of a robot that replays recorded steps."""


def new(
    folder: Path,
    /,
    *,
    mujoco: Flag = False,
    mjcf: Path | None = None,
    policy: Path | None = None,
    process: Flag = False,
    from_: Annotated[Path | None, Parameter(name="--from")] = None,
    columns: Path | None = None,
    names: ColumnNames = NO_COLUMNS,
) -> None:
    """Make a folder with a robot that runs at once: its equations in Python, or one of the forms below.

    Args:
        folder: New folder; its name is the name of the robot.
        mujoco: A MuJoCo model with a controller, from which the nominal map is computed.
        mjcf: The same with your model, MJCF or URDF, such as robot.xml. It is copied with all its files and loaded; the
            controller is to be written.
        policy: A trained velocity policy (ONNX) that moves the robot of --mjcf; nothing is to be written in Python.
        process: A program in any language, and a nominal map of a few numbers; nothing is to be installed.
        from_: The same with a nominal map that is fitted to recorded steps: a run, its steps.csv, or a CSV file of any
            origin, if its columns are named.
        columns: TOML file that names the columns of such a file; its keys are the options from here to --step, and
            units and factors.
    """
    if policy and not mjcf:
        raise InputError(f"--policy {policy}: also give the MuJoCo model of its robot, by --mjcf")
    forms = {"--mujoco": mujoco, "--policy" if policy else "--mjcf": mjcf, "--process": process, "--from": from_}
    given = [name for name, value in forms.items() if value]
    if len(given) > 1:
        raise InputError(f"{' and '.join(given)}: give only one of them")
    if not from_ and (columns or names.given()):
        raise InputError(f"--{next(iter(names.given()), 'columns')}: only with --from, whose columns it names")
    if not folder.name.isprintable():
        raise InputError(f"{folder.name!r}: not a name for a folder; it must be printable")
    if folder.exists():
        raise InputError(f"{folder}: exists already; choose another name{EXISTING_IS_COMPLETE}")
    if process or from_:
        contents = _program(folder.name, _read_log(from_, columns, names) if from_ else None)
    else:
        contents = {}
        if not policy:
            check_package_name(folder.name)
    from stepgap.robots.entry_points import next_commands

    with writing(folder, "FOLDER"):
        folder.parent.mkdir(parents=True, exist_ok=True)
        with new_folder(folder) as partial:
            for name, text in contents.items():
                create(partial / name, text)
            missing = []
            gait = ""
            if policy and mjcf:
                missing, gait = _starter("policy")(partial, folder.name, policy, mjcf)
            elif mjcf:
                _starter("mjcf")(partial, folder.name, mjcf)
            elif not contents:
                write_package(partial, folder.name, MUJOCO if mujoco else EQUATIONS)
    print(folder / "README.md")
    if missing:
        warn(f"fill in {', '.join(missing)} in {folder / 'policy.toml'} first: they are not in {policy}")
    elif gait:
        warn(gait)
    elif mjcf and not policy:
        warn(f"write the controller in {folder / folder.name}.py first, for the joints and actuators of the model")
    for command in next_commands(folder):
        print(f"next: {command}", file=sys.stderr)


def _starter(name: str) -> "Callable[..., Any]":
    """The function that writes a robot from files of others."""
    return load_plugin(STARTERS, "starter", name, callable, "callable with (folder, name, files)")


def _program(name: str, log: "Steps | None") -> dict[str, str]:
    """Files of a robot that is a program, with a template or with recorded steps."""
    from stepgap.records.steps_csv import text_of
    from stepgap.robots.hopper.parameters import CommandBounds

    space = log.space if log else CommandBounds().space()
    kind, file = ("log", "steps.csv") if log else ("template", "template.toml")
    values = {"name": readme_name(name), "kind": kind, "file": file, "quantities": _quantities(space)}
    values["function"] = "take_step" if log else "hop"
    values["nominal"] = "the nominal map is fitted to `steps.csv`" if log else "`template.toml` is the nominal map"
    values["practice"] = f"\n{PRACTICE}" if log else ""
    replayed = Template(starter_text("replayed.py.txt"))
    return {
        "experiment.toml": Template(starter_text("process.toml.txt")).substitute(values),
        "robot.py": replayed.substitute(units=_units(space)) if log else starter_text("process.py.txt"),
        "README.md": Template(starter_text("README_process.md.txt")).substitute(values),
        file: text_of(log) if log else starter_text("template.toml.txt"),
    }


def _read_log(path: Path, columns: Path | None, names: ColumnNames) -> "Steps":
    """Recorded steps; their ranges are those of the run, if it is one, or those that the steps cover.

    Effects that the steps do not show are warned of.
    """
    from stepgap.learning.steps import Steps
    from stepgap.robots.nominal_maps.log_map import fit_log_map

    foreign = columns or names.given()
    steps, space = (_steps_of_others(path, columns, names), None) if foreign else _steps_of_run(path)
    least = len(steps.space.state) + len(steps.space.command) + 2
    if len(steps.completed()) < least:
        raise InputError(f"--from {path}: fewer than {least} completed steps; record some more")
    log = Steps(space or _covered_space(steps), steps)
    for gap in fit_log_map(log).gaps:
        warn(f"--from {path}: {gap}")
    return log


def _steps_of_run(path: Path) -> "tuple[Steps, StepSpace | None]":
    """Steps of a run or of a `steps.csv`, with the ranges of its settings if they are known."""
    from stepgap.experiment.run import Run
    from stepgap.records.missing import Missing
    from stepgap.records.steps_csv import RecordError, read_step_log, space_of_header

    file = path / "steps.csv" if path.is_dir() else path
    try:
        space = space_of_header(file)
        settings = Run(file.parent).settings
        ranges = None if isinstance(settings, Missing) else settings.space
        return read_step_log(file, space), ranges if ranges and ranges.has_names_of(space) else None
    except (OSError, RecordError, ValueError) as error:
        hint = "give a run or its steps.csv; for any other CSV file name its columns, see --help"
        raise InputError(f"--from: {message_of(error)}; {hint}") from None


def _steps_of_others(path: Path, columns: Path | None, names: ColumnNames) -> "Steps":
    """Steps of a log of any origin, which a plug-in reads."""
    read = load_plugin(IMPORTERS, "importer of steps", "columns", callable, "callable with (path, columns, names)")
    return read(path, columns, names.given())


def _covered_space(log: "Steps") -> "StepSpace":
    """Names and units of a log, with the ranges that its steps cover, rounded to a hundredth of their widths."""
    from dataclasses import replace
    from math import floor, log10

    import numpy as np

    from stepgap.step import StepSpace

    def covered(quantities: "Sequence[Quantity]", values: "Array") -> "tuple[Quantity, ...]":
        low = values.min(axis=0)
        high = values.max(axis=0)
        high = np.where(high > low, high, low + np.maximum(np.abs(low), 1.0) * 1e-3)
        digits = [2 - floor(log10(width)) for width in high - low]
        ends = zip(quantities, low.tolist(), high.tolist(), digits, strict=True)
        return tuple(replace(one, lower=round(a, k), upper=round(b, k)) for one, a, b, k in ends)

    completed = log.completed()
    return StepSpace(
        state=covered(log.space.state, completed.state),
        command=covered(log.space.command, completed.requested),
        context=log.space.context,
    )


def _quantities(space: "StepSpace") -> str:
    """The tables of state, command and context of a custom robot."""
    import tomli_w

    blocks = [
        f"\n[[quantities.{kind}]]\n"
        + tomli_w.dumps(
            {
                "name": quantity.name,
                "unit": quantity.unit,
                "lower": float(quantity.lower),
                "upper": float(quantity.upper),
            }
        )
        for kind in ("state", "command")
        for quantity in getattr(space, kind)
    ] + [
        "\n[[quantities.context]]\n"
        + tomli_w.dumps({"name": quantity.name, "unit": quantity.unit, "period": quantity.period})
        for quantity in space.context
    ]
    return "".join(blocks)


def _units(space: "StepSpace") -> str:
    """Names and units, as the program answers them."""
    kinds = {"state": space.state, "command": space.command}
    units = {kind: {quantity.name: quantity.unit for quantity in kinds[kind]} for kind in kinds}
    return json.dumps(units)

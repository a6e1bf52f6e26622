"""The verb `stepgap compare`."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from stepgap.base.errors import InputError
from stepgap.base.files import create
from stepgap.base.output_files import check_new, free_name, writing
from stepgap.cli.terminal import announces_compilation

if TYPE_CHECKING:
    from stepgap.experiment.run import Run
    from stepgap.export.controller.portable_controller import PortableController
    from stepgap.study.individuals import ComparedRobots, Individual


class _Robot(NamedTuple):
    """What is known of a robot.

    Attributes:
        name: Its name.
        passport: Its passport; empty if there is none.
        learned: What was learned of it, or why that is not known.
        run: Its run; None for a model file.
    """

    name: str
    passport: Mapping[str, Any]
    learned: "Individual | str"
    run: "Run | None" = None


@announces_compilation
def compare_robots(robots: list[Path], /, *, out: Path | None = None) -> None:
    """Compare robots of one type, or runs: which one is unlike the others, and in what; and their errors side by side.

    Args:
        robots: Folders of runs, and model files of `stepgap export RUN --to model`.
        out: New HTML file. [default: comparison.html next to the first one, or the next free name]
    """
    from stepgap.experiment.run import Run
    from stepgap.study.comparison_page import MOST_RUNS, check_comparable, run_names
    from stepgap.study.individuals import difference_sentences

    if len(robots) < 2:
        raise InputError("one run or model file cannot be compared; give at least two")
    if len({path.resolve() for path in robots}) < len(robots):
        raise InputError("a run is given twice; give each run once")
    target = out or free_name(robots[0].resolve().parent / "comparison.html")
    check_new(target, "--out")
    sources = [_opened(path) for path in robots]
    runs = [source for source in sources if isinstance(source, Run)]
    if len(runs) == len(sources) <= MOST_RUNS:
        check_comparable(runs)  # before a model is fitted, which takes long
    opened = [_robot(source, name) for source, name in zip(sources, run_names(robots), strict=True)]
    compared = _compared(opened)
    text = _page(opened, compared)
    with writing(target, "--out"):
        create(target, text)
    for line in [compared] if isinstance(compared, str) else difference_sentences(compared):
        print(line)
    print(target)


def _opened(path: Path) -> "Run | PortableController":
    """A run or a model file; raises InputError if it cannot be read."""
    from stepgap.experiment.run import Run
    from stepgap.export.controller.model_reading import read_portable

    return read_portable(path) if path.is_file() else Run(path).checked()


def _robot(source: "Run | PortableController", name: str) -> _Robot:
    """What a run or a model file says of its robot."""
    from stepgap.experiment.run import Run
    from stepgap.export.controller.passport import passport_of
    from stepgap.study.individuals import Individual

    if not isinstance(source, Run):
        name = source.passport.get("name") or name
        return _Robot(name, source.passport, Individual(name, source.nominal, source.learned))
    try:
        residual = source.learner().learned
        learned = Individual(name, source.needed(source.nominal), residual)
        return _Robot(name, passport_of(source, None), learned, source)
    except InputError as error:
        return _Robot(name, {}, str(error), source)


def _compared(robots: Sequence[_Robot]) -> "ComparedRobots | str":
    """The comparison of what was learned, or why there is none; that is an error if there are no runs to compare."""
    from stepgap.study.individuals import Individual, compare_individuals

    learned = [robot.learned for robot in robots if isinstance(robot.learned, Individual)]
    reasons = [robot.learned for robot in robots if isinstance(robot.learned, str)]
    try:
        if reasons:
            raise InputError(reasons[0])
        return compare_individuals(learned)
    except InputError as error:
        if any(robot.run is None for robot in robots):
            raise
        return f"what was learned is not compared: {error}"


def _page(robots: Sequence[_Robot], compared: "ComparedRobots | str") -> str:
    """HTML of the page: what was learned, and of runs the errors, as far as these can be compared."""
    from stepgap.report.html import page, paragraph, section, table
    from stepgap.study.comparison_page import MOST_RUNS, comparison_html
    from stepgap.study.individuals import differences_section

    passports = [_in_words(robot.passport) for robot in robots]
    keys = list(dict.fromkeys(key for passport in passports for key in passport))
    pairs = zip(robots, passports, strict=True)
    rows = [[robot.name, *(passport.get(key, "–") for key in keys)] for robot, passport in pairs]
    learned = paragraph(f"{compared}.") if isinstance(compared, str) else differences_section(compared)
    sections = [learned, section("passports", "Passports", table("", ["", *keys], rows))]
    runs = [robot.run for robot in robots if robot.run is not None]
    if len(runs) == len(robots) and len(runs) <= MOST_RUNS:
        return comparison_html(runs, sections)
    return page("StepGap comparison", [f"<h1>StepGap comparison of {len(robots)} robots</h1>", *sections])


def _in_words(passport: Mapping[str, Any]) -> dict[str, str]:
    """The entries of a passport that are short texts."""
    texts = {key: str(value)[:60] for key, value in passport.items() if isinstance(value, str | int)}
    return {key: value[:12] if key == "settings_sha256" else value for key, value in texts.items() if value}

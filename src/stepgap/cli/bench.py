"""The verbs of `stepgap bench`."""

import json
import os
import sys
from contextlib import redirect_stdout
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any

from cyclopts import App, Parameter, validators

from stepgap.base.errors import InputError
from stepgap.base.output_files import check_new, free_name, writing
from stepgap.cli.options import Flag, Integer, Overrides, add_verb
from stepgap.cli.terminal import announces_compilation

Count = Annotated[Integer, Parameter(validator=validators.Number(gte=1, lte=1000))]
"""Number of repetitions."""


@announces_compilation
def bench_map_(
    experiment: Path | None = None,
    /,
    *,
    quick: Flag = False,
    out: Path | None = None,
    overrides: Overrides = None,
) -> None:
    """Time the nominal map and what is built on it: Jacobian, controller, batches, command table; about a minute.

    Args:
        experiment: TOML file of settings.
        quick: Take only some seconds, with few points.
        out: New JSON file for the result. [default: bench_map.json or the next free name]
    """
    from stepgap.bench.step_map import bench_map, describe_map_bench
    from stepgap.experiment.settings import read_experiment
    from stepgap.robots.hopper.apex_map import ApexMap

    settings = read_experiment(experiment, overrides or [])
    file = _new_file(out, "bench_map.json")
    nominal = ApexMap(settings.robot, settings.gains, settings.command)
    result = bench_map(nominal, settings.seed, quick, _announce)
    print(describe_map_bench(result))
    _write_json(file, result)


def bench_gp_(*, quick: Flag = False, out: Path | None = None) -> None:
    """Time the Gaussian process: fit, prediction, appending one point; some minutes.

    Args:
        quick: Take only some seconds, with few points.
        out: New JSON file for the result. [default: bench_gp.json or the next free name]
    """
    from stepgap.bench.gaussian_process import bench_gp, describe_gp_bench

    file = _new_file(out, "bench_gp.json")
    result = bench_gp(0, quick, _announce)
    print(describe_gp_bench(result))
    _write_json(file, result)


@announces_compilation
def bench_run_(experiment: Path | None = None, /, *, out: Path | None = None, overrides: Overrides = None) -> None:
    """Run an experiment and show how its CPU time is divided: physics, control, learning and so on; about a minute.

    Args:
        experiment: TOML file of settings. [default: the experiment of the paper]
        out: New JSON file for the result. [default: bench_run.json or the next free name]
    """
    from stepgap.bench.run import bench_run, describe_run
    from stepgap.cli.run import Display, run
    from stepgap.experiment.settings import read_experiment

    settings = read_experiment(experiment, overrides or [])
    file, display = _new_file(out, "bench_run.json"), Display(quiet=True)
    with TemporaryDirectory() as folder, redirect_stdout(sys.stderr):
        whole = partial(run, experiment, out=Path(folder) / "run", display=display, overrides=overrides)
        result = bench_run(settings, whole)
    print(describe_run(result))
    _write_json(file, result)


@announces_compilation
def bench_learning_(
    *,
    twins: Count = 20,
    seeds: Count = 3,
    methods: str | None = None,
    quick: Flag = False,
    out: Path = Path("bench_learning.jsonl"),
) -> None:
    """Compare ways to learn on random twins: errors, hops needed, falls, intervals; about an hour of one core.

    Args:
        twins: Number of random twins.
        seeds: Number of seeds of each twin.
        methods: Names of the methods, as NAME,NAME. [default: all]
        quick: Take half a minute: 2 twins, 1 seed, and only the methods linear and gp.
        out: File of JSON lines with all measurements, to which a second call adds the missing ones; the summary and the
            figure get the same name with other endings.
    """
    from stepgap.base.files import write_whole
    from stepgap.bench.learning import SKIPPED, bench_learning
    from stepgap.control.reference import paper_reference
    from stepgap.report.learning import describe_learning, learning_picture, summarise_learning

    chosen = _chosen_methods(methods, quick)
    summary_file, picture_file = _summary_files(out)
    if quick:
        twins, seeds = 2, 1
    workers = os.cpu_count() or 1
    rows = bench_learning(paper_reference(), twins, seeds, chosen, out, workers, _print_line)
    summary = summarise_learning(rows)
    print(describe_learning(summary))
    for name, reason in SKIPPED.items():
        print(f"{name} skipped: {reason}")
    write_whole(summary_file, json.dumps(summary, indent=1))
    write_whole(picture_file, learning_picture(rows, "png"))
    for file in (out, summary_file, picture_file):
        print(file)


def _chosen_methods(methods: str | None, quick: bool) -> list[str]:
    """Names of the compared methods.

    Raises:
        InputError: One of them is unknown or cannot be used here.
    """
    from stepgap.bench.learning import SKIPPED, default_methods
    from stepgap.bench.learning import methods as known_methods

    chosen = methods.split(",") if methods else ["linear", "gp"] if quick else default_methods()
    if unknown := [name for name in chosen if name not in known_methods()]:
        missing = SKIPPED.get(unknown[0], f"it must be one of {', '.join(known_methods())}")
        raise InputError(f"--methods {unknown[0]}: {missing}")
    return chosen


def _summary_files(out: Path) -> tuple[Path, Path]:
    """Files of the summary and of the figure; a second call with the same `out` replaces them."""
    if not out.parent.is_dir() or out.suffix != ".jsonl":
        raise InputError(f"--out {out}: give a name that ends with .jsonl in a folder that exists")
    files = out.with_suffix(".json"), out.with_suffix(".png")
    if not out.exists():
        for file in files:
            check_new(file, "--out")
    return files


def _new_file(out: Path | None, default: str) -> Path:
    """File for a result, which must not exist."""
    file = out or free_name(Path(default))
    check_new(file, "--out")
    return file


def _write_json(file: Path, result: dict[str, Any]) -> None:
    with writing(file, "--out"), file.open("x", encoding="utf-8") as stream:
        json.dump(result, stream, indent=2)
    print(file)


def _announce(line: str) -> None:
    """Prints on stderr the name of the next measurement."""
    print(f"{line} …", file=sys.stderr)


def _print_line(line: str) -> None:
    print(line, file=sys.stderr)


bench = App(name="bench", help="Measure how fast and how accurate StepGap is on this machine, and how well it learns.")
add_verb(bench, "map", bench_map_)
add_verb(bench, "gp", bench_gp_)
add_verb(bench, "run", bench_run_)
add_verb(bench, "learning", bench_learning_)

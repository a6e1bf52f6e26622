"""The verbs of `stepgap bench`."""

import json
import os
import sys
from contextlib import redirect_stdout
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

from cyclopts import App, Parameter, validators

from stepgap.base.output_files import check_new, free_name, writing
from stepgap.base.settings_file import InputError
from stepgap.cli.app import DEBUG_HELP, Overrides, says_if_it_compiles

bench = App(
    name="bench", help="Measure how fast and how exact parts of StepGap are on this machine, and how well it learns."
)


@bench.command(name="map")
@says_if_it_compiles
def bench_map_(
    experiment: Path | None = None,
    /,
    *,
    quick: bool = False,
    out: Path | None = None,
    overrides: Overrides = None,
) -> None:
    """Time the nominal map beside other ways to compute it, and what is built on it; some minutes.

    Args:
        experiment: TOML file of settings.
        quick: Take half a minute, with few points and few peers.
        out: JSON file for the result; without it bench_map.json or the next free name.
    """
    from stepgap.bench.step_map import bench_map, describe_bench
    from stepgap.experiment.settings import read_experiment
    from stepgap.robots.hopper.apex_map import ApexMap

    settings = read_experiment(experiment, overrides or [])
    file = out or free_name(Path("bench_map.json"))
    check_new(file, "--out")
    nominal = ApexMap(settings.robot, settings.gains, settings.command)
    result = bench_map(nominal, settings.seed, quick, lambda line: print(f"{line} …", file=sys.stderr))
    print(describe_bench(result))
    with writing(file, "--out"), file.open("x", encoding="utf-8") as stream:
        json.dump(result, stream, indent=2)
    print(file)


@bench.command(name="gp", help_epilogue=DEBUG_HELP)
def bench_gp_(*, quick: bool = False, out: Path | None = None) -> None:
    """Time the Gaussian process beside those of other libraries: fit, prediction, one point more; some minutes.

    Args:
        quick: Take some seconds, with few points and few peers.
        out: JSON file for the result; without it bench_gp.json or the next free name.
    """
    from stepgap.bench.gaussian_process import bench_gp, describe_gp_bench

    file = out or free_name(Path("bench_gp.json"))
    check_new(file, "--out")
    result = bench_gp(0, quick, lambda line: print(f"{line} …", file=sys.stderr))
    print(describe_gp_bench(result))
    with writing(file, "--out"), file.open("x", encoding="utf-8") as stream:
        json.dump(result, stream, indent=2)
    print(file)


@bench.command(name="run")
@says_if_it_compiles
def bench_run_(experiment: Path | None = None, /, *, out: Path | None = None, overrides: Overrides = None) -> None:
    """Run an experiment and say where the processor's time goes: physics, control, learning and so on; a minute.

    Args:
        experiment: TOML file of settings; without one, the paper's experiment.
        out: JSON file for the result; without it bench_run.json or the next free name.
    """
    from stepgap.bench.run import bench_run, describe_run
    from stepgap.cli.run import run
    from stepgap.experiment.settings import read_experiment

    settings = read_experiment(experiment, overrides or [])
    file = out or free_name(Path("bench_run.json"))
    check_new(file, "--out")
    with TemporaryDirectory() as folder, redirect_stdout(sys.stderr):
        result = bench_run(settings, lambda: run(experiment, out=Path(folder) / "run", quiet=True, overrides=overrides))
    print(describe_run(result))
    with writing(file, "--out"), file.open("x", encoding="utf-8") as stream:
        json.dump(result, stream, indent=2)
    print(file)


@bench.command(name="learning", help_epilogue=DEBUG_HELP)
@says_if_it_compiles
def bench_learning_(
    *,
    twins: Annotated[int, Parameter(validator=validators.Number(gte=1, lte=1000))] = 20,
    seeds: Annotated[int, Parameter(validator=validators.Number(gte=1, lte=1000))] = 3,
    methods: str | None = None,
    quick: bool = False,
    out: Path = Path("bench_learning.jsonl"),
) -> None:
    """Compare ways to learn on random twins: errors, hops needed, falls, intervals; about an hour of one core.

    Args:
        twins: How many; without it 20.
        seeds: How many of each; without it 3.
        methods: Which, as NAME,NAME; without it all.
        quick: Take half a minute: 2 twins, 1 seed, and only linear and gp.
        out: JSON lines of all that is measured, to which a second call adds what is missing; the summary and the
            picture get the same name with other endings. Without it bench_learning.jsonl.
    """
    from stepgap.base.files import write_whole
    from stepgap.bench.learning import SKIPPED, bench_learning, usual_methods
    from stepgap.bench.learning import methods as known_methods
    from stepgap.control.reference import paper_reference
    from stepgap.report.learning import describe_learning, learning_picture, summarise_learning

    chosen = methods.split(",") if methods else ["linear", "gp"] if quick else usual_methods()
    if unknown := [name for name in chosen if name not in known_methods()]:
        missing = SKIPPED.get(unknown[0], f"it must be one of {', '.join(known_methods())}")
        raise InputError(f"--methods {unknown[0]}: {missing}")
    if not out.parent.is_dir() or out.suffix != ".jsonl":
        raise InputError(f"--out {out}: give a name that ends with .jsonl in a folder that exists")
    if not out.exists():  # a second call writes these anew
        for beside in (out.with_suffix(".json"), out.with_suffix(".png")):
            check_new(beside, "--out")
    if quick:
        twins, seeds = 2, 1
    workers = os.cpu_count() or 1
    rows = bench_learning(
        paper_reference(), twins, seeds, chosen, out, workers, lambda line: print(line, file=sys.stderr)
    )
    summary = summarise_learning(rows)
    print(describe_learning(summary))
    for name, reason in SKIPPED.items():
        print(f"{name} skipped: {reason}")
    write_whole(out.with_suffix(".json"), json.dumps(summary, indent=1))
    write_whole(out.with_suffix(".png"), learning_picture(rows, "png"))
    for file in (out, out.with_suffix(".json"), out.with_suffix(".png")):
        print(file)

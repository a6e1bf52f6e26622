"""How fast StepGap is on this machine: `./go python -m benchmarks.speed`."""

import json
import sys
from contextlib import redirect_stdout
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from cyclopts import App

from stepgap.base.output_files import check_new, free_name, write_new
from stepgap.cli.app import main
from stepgap.cli.options import Flag, Overrides, add_verb
from stepgap.cli.terminal import announces_compilation


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
    from benchmarks.speed.step_map import bench_map, describe_map_bench
    from stepgap.experiment.settings import read_experiment
    from stepgap.robots.hopper.model.apex_map import ApexMap
    from stepgap.robots.hopper.robot import as_hopper

    settings = read_experiment(experiment, overrides or [])
    file = _new_file(out, "bench_map.json")
    hopper = as_hopper(settings.robot, "the map is timed")
    nominal = ApexMap(hopper.parameters, hopper.gains, hopper.command)
    result = bench_map(nominal, settings.seed, quick, _announce)
    print(describe_map_bench(result))
    _write_json(file, result)


def bench_gp_(*, quick: Flag = False, out: Path | None = None) -> None:
    """Time the Gaussian process: fit, prediction, appending one point; some minutes.

    Args:
        quick: Take only some seconds, with few points.
        out: New JSON file for the result. [default: bench_gp.json or the next free name]
    """
    from benchmarks.speed.gaussian_process import bench_gp, describe_gp_bench

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
    from benchmarks.speed.run import bench_run, describe_run
    from stepgap.cli.run import Display, run_verb
    from stepgap.experiment.settings import read_experiment

    settings = read_experiment(experiment, overrides or [])
    file, display = _new_file(out, "bench_run.json"), Display(quiet=True)
    with TemporaryDirectory() as folder, redirect_stdout(sys.stderr):
        whole = partial(run_verb, experiment, out=Path(folder) / "run", display=display, overrides=overrides)
        result = bench_run(settings, whole)
    print(describe_run(result))
    _write_json(file, result)


def _new_file(out: Path | None, default: str) -> Path:
    """File for a result, which must not exist."""
    file = out or free_name(Path(default))
    check_new(file, "--out")
    return file


def _write_json(file: Path, result: dict[str, Any]) -> None:
    write_new(file, "--out", json.dumps(result, indent=2))


def _announce(line: str) -> None:
    """Prints on stderr the name of the next measurement."""
    print(f"{line} …", file=sys.stderr)


def speed_line(_: str = "") -> App:
    """The command line."""
    app = App(name="benchmarks.speed", help="Measure how fast StepGap is on this machine.", help_format="plaintext")
    add_verb(app, "step-map", bench_map_)
    add_verb(app, "gp", bench_gp_)
    add_verb(app, "run", bench_run_)
    return app


if __name__ == "__main__":
    main(verbs=speed_line)

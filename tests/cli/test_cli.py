"""The command line: its contract with users and programs, and that bad input does no harm."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import ArrayLike

from stepgap.base.compiled import generic
from stepgap.cli.app import main
from stepgap.cli.help_format import NARROWEST
from stepgap.cli.verbs import GONE, GROUPS
from stepgap.experiment.settings import Experiment, read_experiment
from stepgap.plants.rig_plant import RigPlant
from stepgap.records.steps_csv import StepWriter
from stepgap.report import drawing
from stepgap.rigs.rig import RigFault
from stepgap.robots.hopper.model.apex_map import ApexMap
from stepgap.robots.hopper.parameters import CommandBounds
from stepgap.step import Outcome, StepRecord
from tests.cli.command_line import Command, CommandResult, refused
from tests.full_disk import FILE_TOO_LARGE, largest_file
from tests.quick_runs import leave_out_figures, repeat_less

TARGETS = "speed,height\n0.1,0.56\n0.2,0.58\n0.2,0.58\n"
SHORT = 'seed = 5\nreference = "targets.csv"\n[learning]\niterations = 1\n'


def measure_briefly(patch: pytest.MonkeyPatch) -> None:
    """The noise floor is measured at two yaw angles of one target that has hardly been reached."""
    repeat_less(patch)
    patch.setattr("stepgap.experiment.noise_floor.REPEATED_TARGETS", 1)
    patch.setattr("stepgap.experiment.noise_floor.SETTLING", 1)


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with `short.toml` and its run in `run`."""
    folder = tmp_path_factory.mktemp("finished")
    (folder / "targets.csv").write_text(TARGETS)
    (folder / "short.toml").write_text(SHORT)
    with pytest.MonkeyPatch.context() as patch:
        measure_briefly(patch)
        leave_out_figures(patch)
        main(["run", str(folder / "short.toml"), "--out", str(folder / "run"), "--quiet"])
    return folder


@pytest.fixture(autouse=True)
def fewer_repeats(monkeypatch: pytest.MonkeyPatch) -> None:
    measure_briefly(monkeypatch)


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


def record(folder: Path) -> dict[str, bytes]:
    """Without figures and report, and without times, which differ from run to run."""
    kept = {name: data for name, data in contents(folder).items() if name.endswith((".csv", ".json", ".toml"))}
    return {name: data for name, data in kept.items() if name != "times.json"}


def copied(folder: Path, target: Path) -> Path:
    times = {"times.json": (folder / "times.json").read_bytes()}
    for name, data in (record(folder) | times).items():
        (target / name).parent.mkdir(parents=True, exist_ok=True)
        (target / name).write_bytes(data)
    return target


# The contract of a run


def test_a_run_folder_is_complete(finished: Path) -> None:
    names = set(contents(finished / "run"))
    assert names == {
        "experiment.toml", "reference.csv", "steps.csv", "models/iteration_1.json", "summary.json", "report.html",
        "times.json", "replay/deployment_0.npz", "replay/deployment_1.npz",
    }  # fmt: skip
    summary = json.loads((finished / "run" / "summary.json").read_text())
    assert [entry["steps"] for entry in summary["iterations"]] == [3, 3]
    assert (finished / "run" / "steps.csv").read_text().count("\n") == 9  # each deployment with its start


@pytest.mark.usefixtures("no_report")
def test_its_settings_rerun_it(finished: Path, stepgap: Command) -> None:
    result = stepgap("run", finished / "run" / "experiment.toml", "--out", "again")
    assert (result.code, result.out) == (0, "again/report.html\n")
    assert record(Path("again")) == record(finished / "run")
    lines = result.err.splitlines()
    assert len(lines) == 2, "a plain line for each deployment"
    assert re.fullmatch(r"deployment 0 of 1 \(none\): 3 steps, RMSE speed [0-9.]+ m/s, height [0-9.]+ m", lines[0])
    assert lines[1].startswith("deployment 1 of 1 (posterior): 3 steps, RMSE")


@pytest.mark.usefixtures("no_report", "no_repeats")
def test_without_out_a_run_gets_a_new_folder(finished: Path, stepgap: Command) -> None:
    arguments = ["run", "--reference", finished / "targets.csv", "--iterations", 0, "--quiet"]
    first, second = stepgap(*arguments), stepgap(*arguments, "--seed=6", "--gains.stiffness", "2400")
    for result in (first, second):
        assert re.fullmatch(r"runs/\d{4}-\d\d-\d\d_\d\d-\d\d-\d\d(_2)?/report\.html\n", result.out)
        assert (result.code, result.err) == (0, "")
        assert Path(result.out.strip()).is_file()
    assert first.out != second.out
    assert Path("runs/latest").resolve() == Path(second.out).parent.resolve()
    text = Path("runs/latest/experiment.toml").read_text()
    assert "seed = 6\n" in text
    assert "stiffness = 2400.0\n" in text
    assert json.loads(Path("runs/latest/summary.json").read_text())["seed"] == 6


@pytest.mark.usefixtures("no_report")
@pytest.mark.parametrize("rows", [0, 2, 4])
def test_an_interrupted_run_is_resumed(finished: Path, stepgap: Command, rows: int) -> None:
    folder = copied(finished / "run", Path("run"))
    lines = (folder / "steps.csv").read_text().splitlines(keepends=True)
    (folder / "steps.csv").write_text("".join(lines[: rows + 1]) + "".join(lines[rows + 1 : rows + 2])[:30])
    (folder / "summary.json").unlink()
    settings = (folder / "experiment.toml").read_text()
    former = settings.replace("[learning]\n", '[learning]\nfeature_map = "identity"\n')
    (folder / "experiment.toml").write_text(former)
    result = stepgap("run", "--out", folder, "--resume", "--quiet")
    assert result == CommandResult(0, "run/report.html\n", "")
    assert (folder / "experiment.toml").read_text() == former != settings
    (folder / "experiment.toml").write_text(settings)
    assert record(folder) == record(finished / "run")


@pytest.mark.usefixtures("no_report")
def test_an_extended_run_is_the_longer_run(finished: Path, stepgap: Command) -> None:
    folder = copied(finished / "run", Path("run"))
    done = len(json.loads((folder / "summary.json").read_text())["iterations"])
    assert stepgap("run", "--out", folder, "--extend", "1", "--quiet") == CommandResult(0, "run/report.html\n", "")
    settings = read_experiment(folder / "experiment.toml")
    assert settings.learning.iterations == done
    assert stepgap("run", folder / "experiment.toml", "--out", "whole", "--quiet").code == 0
    assert record(folder) == record(Path("whole"))


def test_only_a_finished_run_is_extended(finished: Path, stepgap: Command) -> None:
    folder = copied(finished / "run", Path("run"))
    refused(stepgap("run", "--out", folder, "--extend", "0"), "--extend: 0 redeployments; give an integer from 1 on")
    (folder / "summary.json").unlink()
    message = "run: the run was interrupted in deployment 0; finish it by: stepgap run --out run --resume"
    refused(stepgap("run", "--out", folder, "--extend", "1"), message)
    copied(finished / "run", folder)
    rows = (folder / "steps.csv").read_text().splitlines(keepends=True)
    (folder / "steps.csv").write_text("".join(rows[:-1]))
    message = "run/summary.json: deployment 1 has 3 steps, 0 of them failed, in steps.csv 2 and 0; both must be of"
    refused(stepgap("run", "--out", folder, "--extend", "1"), message)
    before = (finished / "run" / "experiment.toml").read_bytes()
    assert (folder / "experiment.toml").read_bytes() == before


def test_a_run_interrupted_between_deployments_is_not_extended(finished: Path, stepgap: Command) -> None:
    folder = copied(finished / "run", Path("run"))
    settings = (folder / "experiment.toml").read_text()
    (folder / "experiment.toml").write_text(settings.replace("iterations = 1", "iterations = 4"))
    before = contents(Path())
    message = "run: the run was interrupted before deployment 2; finish it by: stepgap run --out run --resume"
    refused(stepgap("run", "--out", folder, "--extend", "1"), message)
    assert contents(Path()) == before


def test_the_report_is_regenerated(finished: Path, stepgap: Command) -> None:
    folder = copied(finished / "run", Path("run"))
    assert stepgap("report", folder) == CommandResult(0, "run/report.html\n", "")
    assert (folder / "report.html").read_bytes() == (finished / "run" / "report.html").read_bytes()


def test_the_gait_and_its_picture(stepgap: Command) -> None:
    for name in ("gait.png", "gait_2.png"):
        result = stepgap("gait", "--state", "speed=0.1")
        assert (result.code, result.err) == (0, "")
        assert result.out.endswith(f"\n{name}\n")
        assert Path(name).read_bytes().startswith(b"\x89PNG")


# Bad input: one line, exit code 2, no file written or changed


RIG = Path(__file__).parents[2] / "examples" / "rig.toml"


@pytest.mark.parametrize(
    ("arguments", "parts"),
    [
        ("walk", ['"walk"']),
        ("run --frobnicate", ["--frobnicate"]),
        ("run --sed 3", ["--sed", "--seed"]),
        ("run --body_mass 3", ["Unknown option: --body_mass. If it is a setting", "--parameters.body_mass"]),
        ("run --port 8080", ["--host, --port: valid only with --view"]),
        ("run --host ::1", ["--host, --port: valid only with --view"]),
        ("run --view --port 65536", ["65536", "--port"]),
        ("run a.toml b.toml", ["b.toml"]),
        ("run none.toml", ["none.toml: No such file or directory; give an existing TOML file"]),
        ("run --seed", ["--seed requires an argument"]),
        ("run --seed --quiet", ["--seed requires an argument"]),
        ("run --seed -1", ["--seed = -1, but it must lie between 0 and 2⁶³"]),
        ("run --seed 1.5", ['Invalid value for --seed: "1.5" is not an integer']),
        ("run --seed one", ['Invalid value for --seed: "one" is not an integer']),
        ("run --learning.iterations 1.5", ["--iterations = 1.5, but it must be an integer"]),
        ("run --iterations -1", ["--iterations = -1, but it must lie between 0 and 1000"]),
        ("run --iterations=x", ['Invalid value for --iterations: "x" is not an integer']),
        ("run --learning.residual cubic", ["--learning.residual = 'cubic', but it must be one of auto, constant, "]),
        ("run --gains.stiffness", ["--gains.stiffness: give a value"]),
        ("run --gains.stiffness --quiet", ["--gains.stiffness: give a value"]),
        ("run --learning.feature_map linear", ["--learning.feature_map: gone, since", "; leave it out, "]),
        ("run --gains.stifness 3", ["--gains.stifness: unknown key; did you mean stiffness?"]),
        ("run --parameters.body_mass -1", ["--parameters.body_mass = -1.0, but it must be positive"]),
        ("run --parameters.body_mass 1e6", ["reference paper, step 1: ", "out of reach", "body_mass = 1000000.0"]),
        (
            "run --gap.ground_slope 0.01 --gains.stiffness 100 --parameters.gravity 1e300",
            ["out of reach", "bounds with parameters.gravity = 1e+300 and gains.stiffness = 100.0; `stepgap gait`"],
        ),
        ("run --command.fx_lower 40", ["--command.fx_lower = 40.0, but it must lie below fx_upper = 30.0"]),
        ("run --parameters.boom_inertia_vertical 0 --parameters.boom_inertia_horizontal 0", ["boom_stiffness", "must"]),
        ("run --reference none.csv", ["none.csv: No such file or directory; reference must be 'paper', a CSV file"]),
        ("run --reference far.csv", ["reference far.csv, step 2: speed 3 m/s, height 0.55 m is out of reach"]),
        ("run --reference deep.csv", ["reference deep.csv, step 1: speed 0.1 m/s, height -1 m is out of reach"]),
        ("run --reference inf.csv", ["inf.csv, line 2, column 'speed': 'inf'; it must be a finite number"]),
        ("run --reference empty.csv", ["empty.csv, line 1: the header is ''; it must be 'speed,height'"]),
        ("run --out file/below", ["file/below: cannot be written: Not a directory; choose another --out"]),
        ("run --out file", ["file: cannot be written"]),
        ("run --plant ethercat", ["--plant ethercat: give the rig's file by --rig RIG.toml"]),
        ("run --plant twn", ["--plant twn: unknown; it must be one of twin, emulated-ring, "]),
        (
            "run --out used --reference used/reference.csv",
            ["used: neither empty nor a run, it holds reference.csv; choose another --out"],
        ),
        ("run --plant ethercatt --rig none.toml", ["rig 'ethercatt': unknown; did you mean ethercat?"]),
        ("run --plant ethercat --rig none.toml", ["none.toml: No such file or directory"]),
        ("run --plant ethercat --rig none.toml --arm", ["--arm: standard input is not a terminal"]),
        ("run --plant ethercat --rig rig.toml", ["gives torque only with --arm", "rig dry-run"]),
        ("run --rig rig.toml", ["plant 'twin' takes neither"]),
        ("rig emulate --dc --lock-step", ["--dc: not with --lock-step"]),
        ("run --plant emulated-ring --gap.preset none", ["gap.motor_counts must be finite"]),
        ("run --resume", ["--resume: give the run by --out RUN"]),
        ("run --resume --out none", ["none: contains no experiment.toml, so there is no run to continue"]),
        ("run --resume --out folder", ["folder: contains no experiment.toml"]),
        ("run --extend 2 --resume --out folder", ["--resume, --extend: give only --resume for an interrupted run"]),
        ("gait --state speed=0.1,speed=0.2", ["--state speed=0.1,speed=0.2: it must be names, each once"]),
        ("run --extend 2", ["--extend: give the run by --out RUN"]),
        ("run --extend 2 --out none", ["none: contains no experiment.toml, so there is no run to continue"]),
        ("run --resume --out folder --seed 3", ["--resume: the run continues with its own settings"]),
        ("run --resume --out folder a.toml", ["--resume: the run continues with its own settings"]),
        ("report", ["FOLDER"]),
        ("report none", ["none/steps.csv: no such file"]),
        ("report folder", ["folder/steps.csv: no such file"]),
        ("report folder --gains.stiffness 3", ["--gains.stiffness: this command takes no settings"]),
        (
            "gait --state speed=nan",
            ["--state speed=nan: it must be names, each once, with finite numbers, such as speed=0.2,height=0.58"],
        ),
        (
            "gait --state pace=1",
            ["--state pace=1: no name 'pace'; it must be of speed, height"],
        ),
        ("gait --state fast", ["--state fast: no name 'fast'; it must be of speed, height"]),
        ("gait --state height=-1", ["height -1.000000 m: no command makes a step from this state"]),
        ("gait --out file", ["file: exists already; choose another --out"]),
        (
            "gait --out file/below.png",
            ["file/below.png: cannot be written: no folder to write in; choose another"],
        ),
        ("gait --out none/gait.png", ["none/gait.png: cannot be written: no folder to write in"]),
        ("gait --out gait.xyz", ["gait.xyz: the name must end with one of .", ".png"]),
    ],
)
def test_bad_input_is_refused_in_one_line(stepgap: Command, arguments: str, parts: list[str]) -> None:
    Path("file").write_text("keep me")
    Path("folder").mkdir()
    Path("used").mkdir()
    Path("used/reference.csv").write_text("speed,height\n0.1,0.55\n")
    Path("far.csv").write_text("speed,height\n0.1,0.55\n3,0.55\n")
    Path("deep.csv").write_text("speed,height\n0.1,-1\n")
    Path("inf.csv").write_text("speed,height\ninf,0.55\n")
    Path("empty.csv").write_bytes(b"")
    Path("rig.toml").write_bytes(RIG.read_bytes())
    before = contents(Path())
    refused(stepgap(*arguments.split()), *parts)
    assert contents(Path()) == before
    assert not Path("runs").exists()
    assert not list(Path("folder").iterdir())


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("[gains]\nstifness = 3\n", ["bad.toml: [gains] stifness: unknown key; did you mean stiffness?"]),
        ("[gains]\nstiffness = 'a\\nb'\n", ["bad.toml: [gains] stiffness = 'a\\\\nb', but it must be a number"]),
        ("[parameters]\ngravity = nan\n", ["bad.toml: [parameters] gravity = nan, but it must be a number"]),
        ("'a\nb' = 1", ["not TOML"]),
        ('"a\\nb" = 1', ["unknown key"]),
    ],
)
def test_bad_settings_are_refused_in_one_line(stepgap: Command, text: str, parts: list[str]) -> None:
    Path("bad.toml").write_text(text)
    for verb in ("run", "gait"):
        refused(stepgap(verb, "bad.toml"), *parts)
    assert list(contents(Path())) == ["bad.toml"]


def test_a_folder_with_a_run_is_not_overwritten(finished: Path, stepgap: Command) -> None:
    before = contents(finished)
    result = stepgap("run", "--out", finished / "run", "--iterations", 0)
    refused(result, "run: already holds a run; continue it by --resume, or choose another --out")
    assert contents(finished) == before


def drop_row(text: str) -> str:
    lines = text.splitlines(keepends=True)
    return "".join(lines[:2] + lines[3:])


@pytest.mark.parametrize(
    ("spoil", "parts"),
    [
        (
            lambda text: text.replace("0.1,0.56", "0.1,0.57", 1),
            ["steps.csv: its steps are not those that summary.json counts"],
        ),
        (drop_row, ["steps.csv, line 3: not the next step"]),
        (lambda text: text + "rubbish\n", ["steps.csv, line 10: not the next step"]),
        (lambda text: "rubbish\n", ["steps.csv, line 1: the columns must be iteration,"]),
    ],
)
def test_a_record_that_was_tampered_with_is_refused(
    finished: Path, stepgap: Command, spoil: Callable[[str], str], parts: list[str]
) -> None:
    folder = copied(finished / "run", Path("run"))
    (folder / "steps.csv").write_text(spoil((folder / "steps.csv").read_text()))
    before = contents(Path())
    refused(stepgap("run", "--resume", "--out", "run", "--quiet"), *parts)
    assert contents(Path()) == before


def test_a_run_in_progress_is_left_alone(finished: Path, stepgap: Command) -> None:
    folder = copied(finished / "run", Path("run"))
    before = contents(folder)
    with StepWriter(folder / "steps.csv", CommandBounds().space()):
        for option in (["--resume"], ["--extend", "1"]):
            message = "run/steps.csv: another process is writing this run"
            refused(stepgap("run", *option, "--out", "run"), message)
    assert contents(folder) == before


# Interruptions and failures


@pytest.fixture
def trouble(monkeypatch: pytest.MonkeyPatch) -> Callable[[Callable[[], None]], None]:
    """Calls a function in the fifth step."""

    def make(happen: Callable[[], None]) -> None:
        take_step, count = RigPlant.take_step, iter(range(1, 100))

        def watched(plant: RigPlant, command: np.ndarray) -> StepRecord:
            if next(count) == 5:
                happen()
            return take_step(plant, command)

        monkeypatch.setattr(RigPlant, "take_step", watched)

    return make


@pytest.fixture
def _interruptible() -> Iterator[None]:
    """Enables Ctrl-C, which the children of a shell in the background ignore."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("_interruptible", "no_report")
def test_ctrl_c_prints_how_to_resume(finished: Path, stepgap: Command, trouble: Callable) -> None:
    trouble(lambda: signal.raise_signal(signal.SIGINT))
    result = stepgap("run", finished / "short.toml", "--out", "my run", "--quiet")
    assert result == CommandResult(130, "", "stepgap: stopped; resume with: stepgap run --out 'my run' --resume\n")
    assert Path("my run/steps.csv").read_text().count("\n") == 7
    assert stepgap("run", "--out", "my run", "--resume", "--quiet").code == 0
    assert record(Path("my run")) == record(finished / "run")


def test_a_verb_announces_compilation_once(capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    evaluate = ApexMap.evaluate

    def compiling(nominal: ApexMap, state: ArrayLike, command: ArrayLike) -> Outcome:
        for function in (lambda x: x, lambda x: 2 * x):
            generic(function)(1.0)
        return evaluate(nominal, state, command)

    monkeypatch.setattr(ApexMap, "evaluate", compiling)
    main(["gait", "--command", "fx=0"])
    assert capfd.readouterr().err == "stepgap: compiling for this machine, once; this takes about half a minute\n"


def raising(error: Exception) -> Callable[[], None]:
    def happen() -> None:
        raise error

    return happen


@pytest.mark.parametrize(
    ("error", "line"),
    [
        (RigFault("a drive tripped"), "stepgap: a drive tripped\n"),
        (ValueError("a fault\nof ours"), "stepgap: ValueError: a fault of ours\n"),
        (
            OSError(28, "No space left on device", "a.csv"),
            "stepgap: a.csv: No space left on device\n",
        ),
    ],
)
def test_a_failure_is_no_bad_input(
    finished: Path, stepgap: Command, trouble: Callable, error: Exception, line: str
) -> None:
    trouble(raising(error))
    assert stepgap("run", finished / "short.toml", "--out", "run", "--quiet") == CommandResult(1, "", line)
    assert Path("run/steps.csv").read_text().count("\n") == 7, "recorded steps are kept, so that the run can be resumed"


def test_an_unexpected_error_names_what_changes_the_compilation(
    finished: Path, stepgap: Command, trouble: Callable, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("NUMBA_DISABLE_JIT", "0")
    monkeypatch.setenv("NUMBA_CACHE_DIR", "cache")
    trouble(raising(ValueError("a fault")))
    result = stepgap("run", finished / "short.toml", "--out", "run", "--quiet")
    assert result.err == "stepgap: ValueError: a fault (the environment sets NUMBA_DISABLE_JIT; try without)\n"


def test_the_error_of_a_full_disk_names_the_settings(finished: Path, stepgap: Command) -> None:
    with largest_file(1000):
        result = stepgap("run", finished / "short.toml", "--out", "run", "--quiet")
    assert result.code in (1, 2)
    assert re.fullmatch(rf"stepgap: run/experiment\.toml: [^\n]*{FILE_TOO_LARGE}[^\n]*\n", result.err)


@pytest.mark.parametrize(("file", "largest"), [("steps.csv", 900), ("models/iteration_1.json", 100_000)])
def test_a_full_disk_loses_nothing(finished: Path, stepgap: Command, file: str, largest: int) -> None:
    """A run that was killed in deployment 0, before its summary, goes on until the file that is too large."""
    whole = (finished / "run" / "steps.csv").read_bytes()
    folder = copied(finished / "run", Path("run"))
    for name in ("steps.csv", "summary.json", "models/iteration_1.json"):
        (folder / name).unlink()
    with largest_file(largest):
        result = stepgap("run", "--resume", "--out", "run", "--quiet")
    assert result.code in (1, 2)
    assert re.fullmatch(rf"stepgap: run/{re.escape(file)}: [^\n]*{FILE_TOO_LARGE}[^\n]*\n", result.err)
    assert whole.startswith((folder / "steps.csv").read_bytes())
    assert stepgap("run", "--resume", "--out", "run", "--quiet").code == 0
    assert (folder / "steps.csv").read_bytes() == whole


@pytest.mark.usefixtures("made_figures")
def test_figures_are_written_on_demand_and_then_with_every_report(finished: Path, stepgap: Command) -> None:
    shutil.copytree(finished / "run", "run")
    assert stepgap("report", "run").code == 0
    assert not Path("run/figures").exists()
    assert stepgap("report", "run", "--figures").code == 0
    assert {"tracking.png", "gait.pdf"} < {path.name for path in Path("run/figures").iterdir()}
    Path("run/figures/gait.pdf").unlink()
    assert stepgap("report", "run").code == 0
    assert Path("run/figures/gait.pdf").exists(), "no file is that of an older report"
    refused(stepgap("report", "run", "run"), "a report is that of one run", "stepgap compare")


@pytest.mark.usefixtures("made_figures")
def test_the_error_of_a_full_disk_names_the_file_of_the_report(
    finished: Path, stepgap: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    copied(finished / "run", Path("run"))
    monkeypatch.setattr(drawing, "_saved", lambda figure, form: bytes(60_000))
    with largest_file(50_000):
        result = stepgap("report", "run", "--figures")
    assert result == CommandResult(2, "", f"stepgap: run/figures/tracking.png: {FILE_TOO_LARGE}\n")


def test_missing_permission_is_bad_input(finished: Path, stepgap: Command, trouble: Callable) -> None:
    trouble(raising(PermissionError(13, "Permission denied", "a.csv")))
    result = stepgap("run", finished / "short.toml", "--out", "run", "--quiet")
    assert result == CommandResult(2, "", "stepgap: a.csv: Permission denied\n")


def test_debug_shows_where_an_error_arose(stepgap: Command) -> None:
    with pytest.raises(ValueError, match="give a value"):
        stepgap("run", "--gains.stiffness", "--debug")


# Help


@pytest.mark.parametrize(
    ("arguments", "parts"),
    [
        (["--help"], ["Usage: stepgap COMMAND", "run", "gait", "report", "--TABLE.KEY VALUE"]),
        ([], ["Usage: stepgap COMMAND"]),
        (["run", "--help"], ["--out", "--seed", "--iterations", "--resume", "--quiet", "--reference", "EXPERIMENT"]),
        (["gait", "--help"], ["--state", "speed=0.2,height=0.58"]),
        (["report", "--help"], ["FOLDER"]),
    ],
)
def test_help_is_on_stdout(stepgap: Command, arguments: list[str], parts: list[str]) -> None:
    result = stepgap(*arguments)
    assert (result.code, result.err) == (0, "")
    assert "--no-" not in result.out
    for word in parts:
        assert word in result.out


def test_the_help_has_each_verb_once_under_its_heading(stepgap: Command) -> None:
    """A verb of this package without a heading would stand among those of other packages."""
    shown = stepgap("--help").out
    panels = {
        name: re.findall(r"^│ ([a-z]+) ", lines, re.MULTILINE)
        for name, lines in re.findall(r"─ (.*?) ─+╮\n([^╰]*)", shown)
    }
    assert list(panels) == [*GROUPS, "Options"]
    for heading, names in GROUPS.items():
        assert tuple(panels[heading]) == names
    assert "completion" not in shown


def test_a_verb_that_no_list_shows_is_there(stepgap: Command) -> None:
    result = stepgap("completion", "bash")
    assert result.code == 0
    assert "complete -F" in result.out


@pytest.mark.parametrize("verb", ["report", "export", "recover", "doctor", "rig check"])
def test_the_help_of_a_verb_without_settings_names_none(stepgap: Command, verb: str) -> None:
    result = stepgap(*verb.split(), "--help").out
    assert "--TABLE" not in result
    assert "--debug" in result


def test_the_defaults_in_the_help_are_those_of_the_settings(stepgap: Command) -> None:
    """Settings have no default on the command line, so the help states their defaults as text."""
    result, defaults = " ".join(re.sub("[│]", " ", stepgap("run", "--help").out).split()), Experiment()
    for option, value in {
        "--plant NAME": f"the first simulation; of the hopper: {defaults.plant}",
        "--seed INT": defaults.seed,
        "--iterations INT": defaults.learning.iterations,
        "--explore INT": defaults.learning.exploration,
    }.items():
        assert result.partition(option)[2].partition("[default: ")[2].partition("]")[0] == str(value), option


@pytest.mark.parametrize("words", GONE)
def test_what_is_gone_is_answered_by_what_replaces_it(stepgap: Command, words: str) -> None:
    verb, *asked = words.split()
    for arguments in ([*asked, "x"], [f"{each}=x" for each in asked]):
        refused(stepgap(verb, *arguments), f"stepgap: {words}: gone: {GONE[words]}")


@pytest.mark.parametrize("verb", ["run", "sweep", "view", "export", "fit", "gait", "rig check"])
def test_the_help_says_what_a_value_is_and_not_how_it_is_stored(stepgap: Command, verb: str) -> None:
    assert not re.findall(r"--[a-z-]+ (?:STR|FLOAT)\b", stepgap(*verb.split(), "--help").out)


def test_descriptions_are_wrapped_to_the_width_of_the_terminal() -> None:
    program = [sys.executable, "-c", "from stepgap.cli.app import main; main()", "run", "--help"]  # it keeps its width
    environment = {**os.environ, "COLUMNS": "1000"}
    shown = subprocess.run(program, env=environment, capture_output=True, check=True, encoding="utf-8").stdout
    for name in ("plant", "host"):
        (line,) = [line for line in shown.splitlines() if f"--{name} " in line and "│" in line]
        assert "[default: " in line, "the last words of its docstring"


@pytest.mark.parametrize("columns", ["0", "3"])
def test_the_help_ends_on_a_terminal_without_columns(columns: str) -> None:
    program = [sys.executable, "-c", "from stepgap.cli.app import main; main()", "gait", "--help"]
    shown = subprocess.run(program, env={**os.environ, "COLUMNS": columns}, capture_output=True, text=True, check=True)
    assert max(map(len, shown.stdout.splitlines())) <= NARROWEST
    assert "--state" in shown.stdout


def test_the_version_is_that_of_the_package(stepgap: Command) -> None:
    assert re.fullmatch(r"\d+\.\d+\.\d+\S*\n", stepgap("--version").out)


@pytest.mark.parametrize("unbuffered", ["", "1"])
@pytest.mark.parametrize(("output", "reason"), [("/dev/full", "No space left on device"), ("closed", "Broken pipe")])
def test_an_error_of_standard_output_is_one_line(output: str, reason: str, unbuffered: str) -> None:
    program = [sys.executable, "-c", "from stepgap.cli.app import main; main()", "settings"]
    if output == "closed":
        reader, writer = os.pipe()
        os.close(reader)
    elif Path(output).exists():
        writer = os.open(output, os.O_WRONLY)
    else:
        pytest.skip(f"there is no {output} on this system")
    environment = {**os.environ, "PYTHONUNBUFFERED": unbuffered}
    done = subprocess.run(program, stdout=writer, stderr=subprocess.PIPE, text=True, env=environment, check=False)
    os.close(writer)
    assert (done.returncode, done.stderr) == (1, f"stepgap: standard output: {reason}\n")


def test_a_run_that_nobody_reads_any_more_prints_how_to_resume(finished: Path, tmp_path: Path) -> None:
    reader, writer = os.pipe()
    os.close(reader)
    program = [sys.executable, "-c", "from stepgap.cli.app import main; main()"]
    command = [*program, "run", finished / "short.toml", "--out", "run", "--json", "--quiet"]
    done = subprocess.run(command, stdout=writer, stderr=subprocess.PIPE, text=True, cwd=tmp_path, check=False)
    os.close(writer)
    assert done.returncode == 1
    assert done.stderr.splitlines()[-2:] == [
        "stepgap: the run was stopped; resume with: stepgap run --out run --resume",
        "stepgap: standard output: Broken pipe",
    ]


@pytest.mark.parametrize("encoding", ["ascii", "latin-1"])
def test_what_the_encoding_of_standard_output_lacks_is_replaced(encoding: str) -> None:
    program = [sys.executable, "-c", "from stepgap.cli.app import main; main()", "settings"]
    whole, replaced = (
        subprocess.run(program, env={**os.environ, "PYTHONIOENCODING": name}, capture_output=True, check=True).stdout
        for name in ("utf-8", encoding)
    )
    assert not whole.isascii()
    assert replaced == whole.decode().encode(encoding, "replace")


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["export", "run", "--to", "mat", "--out", ""], "--out"),
        (["run", "--warm-start", ""], "--warm-start"),
        (["run", "--reference="], "--reference"),
        (["report", ""], "an argument"),
    ],
)
def test_an_empty_value_is_refused(stepgap: Command, arguments: list[str], named: str) -> None:
    refused(stepgap(*arguments), f"{named}: empty; give a value")
    assert not list(Path().iterdir())


CTRL_C_IN_AN_IMPORT = """
import sys

class Interrupted:
    def find_spec(self, name, path=None, target=None):
        if name == "cyclopts":
            raise KeyboardInterrupt

sys.meta_path.insert(0, Interrupted())
from stepgap.cli.start import start
start()
"""


def test_ctrl_c_during_the_first_imports_is_one_line() -> None:
    done = subprocess.run([sys.executable, "-c", CTRL_C_IN_AN_IMPORT], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "stepgap: stopped\n")


CTRL_C_IN_A_MODULE_OF_C = """
import sys

class Interrupted:
    def find_spec(self, name, path=None, target=None):
        if name == "numba":
            raise ImportError("initialization failed") from KeyboardInterrupt()

sys.meta_path.insert(0, Interrupted())
sys.argv = ["stepgap", "gait"]
from stepgap.cli.start import start
start()
"""


def test_ctrl_c_while_a_module_of_c_is_imported_is_one_line() -> None:
    """Such a module answers it by an ImportError."""
    done = subprocess.run([sys.executable, "-c", CTRL_C_IN_A_MODULE_OF_C], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "stepgap: stopped\n")


CTRL_C_IN_A_CALLBACK = """
import ctypes, signal, sys, time
from stepgap.cli import app, start

def callback():
    signal.raise_signal(signal.SIGINT)

def main():
    ctypes.CFUNCTYPE(None)(callback)()
    time.sleep(60)

app.main = main
start.start()
"""


def test_ctrl_c_in_a_callback_of_c_is_not_lost() -> None:
    done = subprocess.run([sys.executable, "-c", CTRL_C_IN_A_CALLBACK], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "stepgap: stopped\n")


def test_standard_output_may_be_closed() -> None:
    program = f"{sys.executable} -c 'from stepgap.cli.app import main; main()' settings >&-"
    done = subprocess.run(["/bin/sh", "-c", program], stderr=subprocess.PIPE, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


def test_a_full_cache_of_compiled_code_is_named(tmp_path: Path) -> None:
    program = [sys.executable, "-c", "from stepgap.cli.app import main; main()", "gait", "--command", "fx=0"]
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path), "PYTHONDONTWRITEBYTECODE": "1"}  # no short files
    with largest_file(1000):
        done = subprocess.run(program, capture_output=True, text=True, env=environment, check=False)
    assert done.returncode == 1
    assert done.stderr.splitlines()[-1] == f"stepgap: {tmp_path}: {FILE_TOO_LARGE}"


HEAVY = {"numba", "scipy", "mujoco", "matplotlib", "rich.markdown"}


TEXTS = ["run --help", "run --no-such-option", "settings", "completion bash", "--help", "--no-such-option"]


def test_what_only_prints_text_imports_nothing_heavy() -> None:
    asked = f"""
import sys, stepgap.cli.app
for arguments in {TEXTS}:
    try:
        stepgap.cli.app.main(arguments.split())
    except SystemExit:
        pass
    print(arguments, {HEAVY} & sys.modules.keys(), file=sys.stderr)
"""
    done = subprocess.run([sys.executable, "-c", asked], capture_output=True, text=True, check=True)
    assert [line for line in done.stderr.splitlines() if line.endswith(" set()")] == [f"{text} set()" for text in TEXTS]


@pytest.mark.parametrize("arguments", [["run", "one.toml", "two.toml"], ["doctor", "two.toml"]])
def test_extra_arguments_are_named(arguments: list[str], stepgap: Command) -> None:
    refused(stepgap(*arguments), "two.toml: too many arguments")

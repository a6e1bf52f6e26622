"""`stepgap fit`: its results for logs with known errors, its output files, and the input that it refuses."""

import json
from pathlib import Path

import numpy as np
import pytest

from stepgap.learning.residual_fit import fit_residual, residual_from_dict
from stepgap.learning.steps import LoggedStep
from stepgap.records.model_files import MAP, NominalSource, read_saved_model
from stepgap.records.steps_csv import StepWriter
from stepgap.robots.hopper import CommandBounds
from stepgap.robots.hopper.model.apex_map import ApexMap
from stepgap.step import StepRecord, StepStatus
from tests.cli.command_line import Command, refused
from tests.learning.test_own_residual import install, packages
from tests.learning.test_residual import steps

__all__ = ["packages"]

FOREIGN = ("--state", "v,y", "--next", "v2,y2", "--command", "fx,fy", "--nominal", "state")


def compare_few_kinds(patch: pytest.MonkeyPatch, *kinds: str) -> None:
    patch.setattr("stepgap.learning.entry_points.names_by_complexity", lambda: kinds)


@pytest.fixture(autouse=True)
def _few_kinds(monkeypatch: pytest.MonkeyPatch) -> None:
    compare_few_kinds(monkeypatch, "none", "constant", "gp")


def write_log(path: Path, offset: float, count: int = 40, seed: int = 0) -> None:
    """Writes steps that change the first coordinate by an offset, with noise, independent of the command."""
    rng = np.random.default_rng(seed)
    numbers = rng.uniform(-1, 1, (count, 4))
    after = numbers[:, :2] + rng.normal(size=(count, 2)) * 0.1 + [offset, 0]
    rows = [",".join(map(repr, row)) for row in np.hstack([numbers, after]).tolist()]
    path.write_text("\n".join(["v,y,fx,fy,v2,y2", *rows]) + "\n")


def write_run(folder: Path, offset: float) -> None:
    """Writes the record of two deployments on a hopper with an offset in height; the last step is a fall."""
    folder.mkdir()
    rng, bounds = np.random.default_rng(0), CommandBounds().space()
    states, commands = rng.uniform([0.1, 0.55], [0.3, 0.6], (31, 2)), rng.uniform(-2, 2, (31, 2))
    after = ApexMap()(states, commands) + [0, offset] + rng.normal(size=(31, 2)) * [4e-3, 1e-3]
    with StepWriter(folder / "steps.csv", bounds) as writer:
        for i in range(31):
            status = StepStatus.OK if i < 30 else StepStatus.FELL
            end = after[i] if i < 30 else np.full(2, np.nan)
            record = StepRecord(states[i], 3 * commands[i], commands[i] / 2, end, status, requested=commands[i])
            writer.append(LoggedStep(i // 15, i % 15 + 1, states[i], states[i], np.zeros(2), record))


def test_an_offset_in_a_foreign_log(stepgap: Command) -> None:
    write_log(Path("log.csv"), 0.5)
    result = stepgap("fit", "log.csv", *FOREIGN, "--out", "fit.json", "--save", "model.json", "--plot", "fit.png")
    assert (result.code, result.err) == (0, "")
    lines = result.out.splitlines()
    assert lines[0] == "steps       40 of 1 deployment; rows left out: none"
    assert "held out    10 contiguous blocks, one at a time" in lines
    assert lines[-3:] == ["fit.json", "model.json", "fit.png"]
    assert lines[-4].startswith("best:           constant, ")
    assert "less error than without a correction; " in lines[-4]
    report = json.loads(Path("fit.json").read_text())
    assert report["best"]["kind"] == "constant"
    assert report["best"]["gain"] == report["residuals"][1]["better_than"]["none"]["all"]
    assert report["suspicious"] == {}
    assert [entry["kind"] for entry in report["residuals"]] == ["none", "constant", "gp"]
    constant = report["residuals"][1]
    assert constant["rmse"]["v"] == pytest.approx(0.1, rel=0.4)
    assert constant["better_than"]["none"]["v"]["value"] == pytest.approx(0.8, abs=0.1)
    assert Path("fit.png").read_bytes().startswith(b"\x89PNG")
    model = json.loads(Path("model.json").read_text())
    described = {"schema": 1, "state": [["v", ""], ["y", ""]], "command": [["fx", ""], ["fy", ""]], "nominal": "state"}
    assert model.items() >= described.items()
    residual = residual_from_dict(model)
    np.testing.assert_allclose(residual.mean(np.zeros((1, 4))), [[0.5, 0]], atol=0.06)


def test_a_model_that_was_saved_from_a_run_is_read_for_its_nominal_map_only(stepgap: Command) -> None:
    write_run(Path("run"), 0.05)
    assert stepgap("fit", "run", "--save", "model.json").code == 0
    nominal = ApexMap()
    residual = read_saved_model(Path("model.json"), nominal.space, NominalSource(MAP, nominal))
    assert residual.mean(np.array([[0.2, 0.58, 0.0, 0.0]]))[0, 1] == pytest.approx(0.05, abs=0.002)
    with pytest.raises(ValueError, match=r"learned with '--nominal map', but .* '--nominal state'"):
        read_saved_model(Path("model.json"), nominal.space, NominalSource("state"))


def test_a_wrong_row_is_named_and_left_out(stepgap: Command) -> None:
    write_log(Path("log.csv"), 0.5)
    lines = Path("log.csv").read_text().splitlines()
    Path("wrong.csv").write_text("\n".join([*lines[:8], "-999" + lines[8][lines[8].index(",") :], *lines[9:]]) + "\n")
    result = stepgap("fit", "wrong.csv", *FOREIGN, "--out", "fit.json")
    assert "suspicious  1 row, left out below: wrong.csv, line 9 (v = -999, others" in result.out
    report = json.loads(Path("fit.json").read_text())
    assert (report["steps"], list(report["suspicious"])) == (39, ["wrong.csv, line 9"])


def test_residuals_are_fitted_to_some_logs_and_scored_on_others(stepgap: Command) -> None:
    write_log(Path("log.csv"), 0.5)
    write_log(Path("other.csv"), 0.5, seed=1)
    result = stepgap("fit", "log.csv", "--test", "other.csv", *FOREIGN, "--out", "fit.json")
    assert (result.code, result.err) == (0, "")
    assert "held out    40 steps of other logs" in result.out
    constant = json.loads(Path("fit.json").read_text())["residuals"][1]
    assert constant["rmse"]["v"] == pytest.approx(0.1, rel=0.4)
    refused(stepgap("fit", "log.csv", "--test", "log.csv", *FOREIGN), "log.csv", "one of both")
    refused(stepgap("fit", "log.csv", "--test", "other.csv", "--folds", 3, *FOREIGN), "--folds")


def test_a_run_is_judged_against_the_nominal_map(stepgap: Command) -> None:
    write_run(Path("run"), 0.01)
    result = stepgap("fit", "run")
    assert (result.code, result.err) == (0, "")
    assert "steps       30 of 2 deployments; rows left out: 1 that ended without a next state" in result.out
    assert "state       speed [m/s], height [m]" in result.out
    assert "nominal     the robot's nominal map with default settings" in result.out
    assert "held out    2 parts of whole deployments, one at a time" in result.out
    assert " less error than without a correction; " in result.out.splitlines()[-1]
    # The same rows as any CSV, by the names of their columns, without their deployments.
    columns = {"state": "speed,height", "next": "next_speed,next_height", "command": "fx=requested_fx,fy=requested_fy"}
    options = [part for name, text in columns.items() for part in (f"--{name}", text)]
    again = stepgap("fit", "run/steps.csv", *options, "--folds", 2)
    assert "rows left out: 1 with a number missing" in again.out
    assert "held out    2 contiguous blocks" in again.out
    assert rmse_of_gp(again.out) == rmse_of_gp(result.out), "deployments of this run are its two halves"


def rmse_of_gp(out: str) -> str:
    """RMSE of the GP in the first state coordinate."""
    return next(line.split()[1] for line in out.splitlines() if line.startswith("gp "))


def test_settings_are_those_of_the_run(stepgap: Command) -> None:
    write_run(Path("run"), 0.0)
    Path("run/experiment.toml").write_text("[gains]\nstiffness = 2400\n[learning]\nfeature_map = 'identity'\n")
    result = stepgap("fit", "run", "--gains.rest_length", "0.28")
    assert "nominal map with the settings of run/experiment.toml, some overridden" in result.out
    assert "nothing to learn" not in result.out.splitlines()[-1]
    write_run(Path("other"), 0.0)
    refused(stepgap("fit", "run", "other"), "other/steps.csv: recorded with another robot or nominal map than run/")


def test_columns_from_a_file(stepgap: Command) -> None:
    write_log(Path("log.csv"), 0.0, count=21)
    Path("columns.toml").write_text('state = ["v", "y"]\ntarget = ["v2", "y2"]\n[units]\nv = "m/s"\n')
    result = stepgap("fit", "log.csv", "--columns", "columns.toml", "--nominal", "target", "--folds", "2")
    assert result.code == 0
    assert "steps       20 of 1 deployment; rows left out: 1 at the end of a chain" in result.out
    assert "state       v [m/s], y" in result.out
    assert "command     v2, y2" in result.out
    assert "nominal     the target" in result.out


WRONG = [
    ("fit", ["LOG: none given"]),
    ("fit none.csv", ["none.csv: No such file or directory; give the folder of a run"]),
    ("fit folder", ["folder/steps.csv: No such file or directory; give the folder of a run"]),
    ("fit log.csv", ["log.csv, line 1: the columns must be iteration,", "name its columns, see --help"]),
    ("fit folder --yaw psi", ["folder: a folder that is not a run, which has a steps.csv; give the log's file"]),
    ("fit run --yaw psi", ["run: a run, whose columns are known; leave out --yaw"]),
    (
        "fit header.csv --state v --command fx --nominal state",
        ["no row holds a complete step; rows left out: 1 at"],
    ),
    ("fit log.csv --state v,y", ["--command: no column"]),
    ("fit log.csv --state w,y --command fx", ["log.csv, line 1: state 'w': no column 'w'; there is v, y, fx"]),
    ("fit log.csv --state v,y --command fxx", ["command 'fxx': no column 'fxx'; did you mean 'fx'?"]),
    ("fit log.csv --state v, --command fx", ["--state = 'v,', but it must be names, and none may"]),
    ("fit log.csv --columns none.toml", ["none.toml: No such file or directory"]),
    ("fit log.csv --columns file", ["file: not TOML"]),
    ("fit log.csv --state v,y --command fx,fy", ["--nominal: the log contains no predicted next states; name"]),
    ("fit log.csv --state v,y --command fx --nominal map", ["--nominal map: state and command are v,y,fx; it"]),
    ("fit log.csv --state v,y --command fx --nominal target", ["--nominal target: the log has none; name"]),
    ("fit log.csv --state v,y --command fx --nominal mean", ["--nominal", "mean"]),
    ("fit log.csv --state v --command fx --nominal state --gains.stiffness 3", ["state: it has no settings"]),
    ("fit log.csv --state v --command fx --nominal state --folds 1", ["--folds 1: it must lie between 2 and"]),
    ("fit log.csv --state v --command fx --nominal state --folds x", ["--folds", "x"]),
    ("fit few.csv --state v --command fx --nominal state", ["few.csv: 4 usable steps, but there must be 20 to"]),
    ("fit log.csv --out file", ["file: exists already; choose another --out"]),
    ("fit log.csv --save file", ["file: exists already; choose another --save"]),
    ("fit log.csv --plot file", ["file: exists already; choose another --plot"]),
    ("fit log.csv --plot none/fit.png", ["none/fit.png: cannot be written", "choose another --plot"]),
    ("fit log.csv --plot fit.xyz", ["fit.xyz: the name must end with one of .pdf, .png, .svg"]),
    ("fit log.csv --gains.stifness 3", ["--gains.stifness: unknown key; did you mean stiffness?"]),
    ("fit run --learning.residual linear", ["--learning.residual: every residual is fitted, without settings of"]),
]


def test_bad_input_is_refused_in_one_line(stepgap: Command) -> None:
    Path("file").write_text("keep me")
    Path("folder").mkdir()
    write_log(Path("log.csv"), 0.0)
    write_log(Path("few.csv"), 0.0, count=5)
    write_log(Path("header.csv"), 0.0, count=1)
    write_run(Path("run"), 0.0)
    before = {path: path.read_bytes() for path in Path().iterdir() if path.is_file()}
    for arguments, parts in WRONG:
        refused(stepgap(*arguments.split()), *parts)
    assert {path: path.read_bytes() for path in Path().iterdir() if path.is_file()} == before


def test_help(stepgap: Command) -> None:
    result = stepgap("fit", "--help")
    assert (result.code, result.err) == (0, "")
    for word in ("LOG", "--columns", "--next", "--nominal", "--folds", "--save"):
        assert word in result.out


OUT_OF_SPACE = """
from stepgap.learning.regression import ResidualModel
def fit(data):
    raise OSError(28, "No space left")
MODEL = ResidualModel("own", "a model that fails", fit, fit)
"""


@pytest.mark.filterwarnings("default::stepgap.base.errors.StepGapWarning")
def test_a_residual_that_fails_is_left_out_with_one_line(
    stepgap: Command, packages: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    install(packages, "broken", OUT_OF_SPACE, own="broken:MODEL")
    compare_few_kinds(monkeypatch, "none", "constant", "own")
    write_log(Path("log.csv"), offset=0.5)
    result = stepgap("fit", "log.csv", *FOREIGN, "--out", "fit.json")
    assert result.code == 0
    assert result.err.count("stepgap: left out: residual 'own': OSError: [Errno 28] No space left\n") == 1
    compared = json.loads(Path("fit.json").read_text())["residuals"]
    assert [each["kind"] for each in compared] == ["none", "constant"]


def test_a_residual_that_fails_in_a_run_is_named_by_its_file_and_line(
    stepgap: Command, packages: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    install(packages, "broken", OUT_OF_SPACE, own="broken:MODEL")
    monkeypatch.setattr("stepgap.cli.app.run_words", lambda arguments, program, verbs: fit_residual("own", steps()))
    result = stepgap("run")
    assert result.code == 2
    assert result.err.startswith(
        "stepgap: packages/broken.py, line 4: residual 'own': OSError: [Errno 28] No space left ("
    )

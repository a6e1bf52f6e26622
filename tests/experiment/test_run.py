import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from stepgap.base.errors import InputError
from stepgap.experiment.run import Run
from stepgap.experiment.settings import Experiment, SettingsFile
from stepgap.learning.settings import LearningSettings
from stepgap.learning.steps import column_names
from stepgap.records import steps_csv
from stepgap.records.steps_csv import StepWriter, digest, space_of_header
from stepgap.step import ContextQuantity, Quantity, StepSpace, StepStatus
from tests.report.runs import logged, write_run, write_summary

NAMES = ("speed", "tilt")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return write_run(tmp_path / "run", NAMES, steps=5)


def complaint(folder: Path) -> str:
    """The error message for a bad run folder: one line, with no path except those of the folder."""
    with pytest.raises(InputError) as caught:
        Run(folder).checked()
    text = str(caught.value)
    assert "\n" not in text
    assert text.startswith(str(folder))
    return text.replace(str(folder), "RUN")


def edit_summary(folder: Path, change: Callable[[dict[str, Any]], object]) -> None:
    content = json.loads((folder / "summary.json").read_text())
    change(content)
    (folder / "summary.json").write_text(json.dumps(content))


def test_record_is_what_was_written(folder: Path) -> None:
    edit_summary(folder, lambda content: content["iterations"][1]["mae"].update(tilt=0.25))
    edit_summary(folder, lambda content: content.update(versions={"mujoco": "3.17", "cores": 2}))
    (folder / "experiment.toml").write_text("seed = 0\n")
    run = Run(folder).checked()
    assert run.space.state_names == NAMES
    assert [len(run.steps.of_iteration(number)) for number in run.shown_iterations] == [5, 5]
    np.testing.assert_array_equal(run.deployments[1].errors["mae"], [np.nan, 0.25])
    np.testing.assert_array_equal(run.noise_floor, [np.nan, np.nan])
    assert run.summary.versions == (("mujoco", "3.17"), ("cores", "2"))
    assert run.settings_file == SettingsFile("seed = 0\n", {"seed": 0})
    assert run.unfinished == {}


def test_an_unfinished_deployment_is_no_error(folder: Path) -> None:
    edit_summary(folder, lambda content: content["iterations"].pop())
    run = Run(folder).checked()
    assert (run.shown_iterations, run.unfinished) == ([0], {1: 5})
    (folder / "summary.json").unlink()
    run = Run(folder).checked()
    assert (run.shown_iterations, run.unfinished, run.summary.seed) == ([0, 1], {0: 5, 1: 5}, None)


def test_row_being_written_is_left_out(folder: Path) -> None:
    with (folder / "steps.csv").open("a") as file:
        file.write("2,1,0.1")
    assert len(Run(folder).checked().steps) == 10


@pytest.mark.parametrize("state", [("x",), ("a", "b"), ("x", "target_x"), ("next_y", "y", "ÿz")])
@pytest.mark.parametrize(
    "command", [("f",), ("f", "g"), ("f", "g", "h", "i", "j", "k", "applied_f"), ("f", "requested_f")]
)
def test_header_gives_the_names_back(tmp_path: Path, state: tuple[str, ...], command: tuple[str, ...]) -> None:
    states, commands = (tuple(Quantity(name, "", -1, 1) for name in names) for names in (state, command))
    names = column_names(StepSpace(states, commands))
    path = tmp_path / "steps.csv"
    path.write_text(",".join(names) + "\n", encoding="utf-8")
    if len(set(names)) < len(names):
        with pytest.raises(ValueError, match="not the header of a step log"):
            space_of_header(path)
    else:
        found = space_of_header(path)
        assert (found.state_names, found.command_names) == (state, command)


def test_a_long_header_gives_the_names_back(tmp_path: Path) -> None:
    states, commands = (tuple(Quantity(f"{kind}_{i:057}", "", -1, 1) for i in range(100)) for kind in ("qd", "tq"))
    context = tuple(ContextQuantity(f"marker_{number}", "") for number in range(100))
    space = StepSpace(states, commands, context)
    path = tmp_path / "steps.csv"
    path.write_text(",".join(column_names(space)) + "\n", encoding="utf-8")
    found = space_of_header(path)
    assert (found.names, found.context_names) == (space.names, space.context_names)


def test_a_long_header_of_no_step_log_is_refused(tmp_path: Path) -> None:
    """With each number of coordinates tried beside each number of names that end in _after, it would take minutes."""
    path, context = tmp_path / "steps.csv", [f"x{number}_after" for number in range(1400)]
    path.write_text(",".join(["iteration", "step", *map("b{}".format, range(600)), *context, "status"]) + "\n")
    with pytest.raises(ValueError, match="not the header of a step log"):
        space_of_header(path)


def test_no_unit_follows_from_a_name(tmp_path: Path) -> None:
    space = StepSpace((Quantity("height", "mm", -1, 1),), (Quantity("fx", "kN", -1, 1),))
    path = tmp_path / "steps.csv"
    path.write_text(",".join(column_names(space)) + "\n", encoding="utf-8")
    found = space_of_header(path)
    assert [quantity.unit for quantity in (*found.state, *found.command)] == ["", ""]


def test_space_may_be_given(folder: Path) -> None:
    space = StepSpace(tuple(Quantity(name, "rad", -1, 1) for name in NAMES), (Quantity("push", "N", -1, 1),))
    assert Run(folder, space=space).checked().space is space
    other = StepSpace(space.state, (Quantity("pull", "N", -1, 1),))
    with pytest.raises(ValueError, match=r"steps\.csv, line 1: the columns must be"):
        Run(folder, space=other).checked()


def test_a_folder_that_is_not_a_run_is_refused(tmp_path: Path) -> None:
    for wrong in (tmp_path, tmp_path / "missing", tmp_path / "file"):
        (tmp_path / "file").touch()
        assert "must be the folder of a run" in complaint(wrong)


NO_STEP_LOGS = {
    "binary": b"\x00\xff\x89PNG",
    "foreign": b"a,b,c\n1,2,3\n",
    "no names": b"iteration,step,status\n",
    "cut": b"iteration,step",
    "endless": b"x," * 10**6,
}


@pytest.mark.parametrize("content", NO_STEP_LOGS.values(), ids=NO_STEP_LOGS.keys())
def test_a_file_that_is_not_a_step_log_is_refused(folder: Path, content: bytes) -> None:
    (folder / "steps.csv").write_bytes(content)
    assert complaint(folder).startswith(
        "RUN/steps.csv, line 1: not the header of a step log; it must be iteration, step"
    )


@pytest.mark.parametrize(
    ("row", "message"),
    [
        ("", "RUN/steps.csv: no step yet; it must have a header and at least one row"),
        ("0,1,2\n", "RUN/steps.csv, line 2: not the next step (3 columns instead of 19)"),
        ("0,1,nan,0,0,0,0,0,0,0,0,0,0,0,0,1,1,0,ok\n", "RUN/steps.csv, line 2: not the next step"),
        ("0,1,0,0,0,0,0,0,0,0,0,0,0,0,0,1,1,0,flew\n", "RUN/steps.csv, line 2: not the next step"),
        ("0,2,0,0,0,0,0,0,0,0,0,0,0,0,0,1,1,0,ok\n", "RUN/steps.csv, line 2: not the next step"),
        ("-1,1,0,0,0,0,0,0,0,0,0,0,0,0,0,1,1,0,ok\n", "RUN/steps.csv, line 2: not the next step"),
        ("0,1,0,0,0,0,0,0,0,0,0,0,0,0,0,1,1,inf,ok\n", "RUN/steps.csv, line 2: not the next step"),
        ("0,1,0,0,0,0,0,0,0,0,0,0,0,0,0,1,-1,0,ok\n", "std_… negative"),
        ("0,1,0,0,0,0,0,0,0,1e300,0,0,0,0,0,1,1,0,ok\n", "a state is larger than ±1e+09"),
    ],
)
def test_wrong_steps_are_refused(folder: Path, row: str, message: str) -> None:
    (folder / "summary.json").unlink()
    header = (folder / "steps.csv").read_text().splitlines(keepends=True)[0]
    (folder / "steps.csv").write_text(header + row)
    assert message in complaint(folder)


def test_unknown_prediction_and_fall_are_read(folder: Path) -> None:
    rows = "0,1,0,0,0,0,0,0,0,0,0,nan,nan,nan,inf,1,1,0.5,ok\n0,2,0,0,0,0,0,0,0,nan,nan,nan,nan,0,0,1,1,nan,fell\n"
    (folder / "summary.json").unlink()
    header = (folder / "steps.csv").read_text().splitlines(keepends=True)[0]
    (folder / "steps.csv").write_text(header + rows)
    assert Run(folder).checked().steps.failed_steps == 1


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "not JSON"),
        (b'{"schema": 1, "seed": 0, "iterat', "not JSON"),
        (b"[" * 10**6, "not JSON"),
        (b'{"schema": NaN}', "not JSON (NaN is not a JSON number)"),
        (b"\xff\xfe\x00", "not a text file"),
        (b"[1]", "but it must be an object"),
        (b"{}", "schema is missing, but it must be 1"),
        (b'{"schema": 2}', "schema is 2, but it must be 1"),
        (b'{"schema": true}', "schema is true, but it must be 1"),
        (b'{"schema": 1, "iterations": []}', "iterations is [], but it must be a list of deployments"),
        (b'{"schema": 1, "iterations": ["x"]}', "iterations[0] is 'x', but it must be an object"),
    ],
)
def test_a_file_that_is_not_a_summary_is_refused(folder: Path, content: bytes, message: str) -> None:
    (folder / "summary.json").write_bytes(content)
    text = complaint(folder)
    assert text.startswith("RUN/summary.json: ")
    assert message in text


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda content: content.pop("seed"), "seed is missing, but it must be an integer from 0"),
        (lambda content: content.update(seed=10**400), "seed is a very large integer"),
        (lambda content: content.pop("repeatability"), "repeatability is missing"),
        (lambda content: content.update(versions=[1]), "versions is [1], but it must be an object"),
        (lambda content: content["iterations"][0].update(residual=3), "iterations[0]: residual is 3"),
        (lambda content: content["iterations"][0].update(residual="x" * 101), "but it must be a short string"),
        (lambda content: content["iterations"][0].update(steps=True), "steps is true, but it must be an integer"),
        (lambda content: content["iterations"][0].pop("mae"), "iterations[0]: mae is missing"),
        (lambda content: content["iterations"][1].update(mae={"speed": 1}), "but it must have speed, tilt"),
        (
            lambda content: content["iterations"][1]["mae"].update(tilt="0.1"),
            "mae of tilt is '0.1', but it must be a number",
        ),
        (lambda content: content["iterations"][1]["mae"].update(tilt=10**400), "but it must be a number or null"),
        (lambda content: content["iterations"].reverse(), "the number of iterations is [1, 0], but it must increase"),
        (
            lambda content: content["iterations"][1].update(steps=6),
            "has 6 steps, 0 of them failed, in steps.csv 5 and 0",
        ),
        (
            lambda content: content["iterations"][1].update(falls=1),
            "has 5 steps, 1 of them failed, in steps.csv 5 and 0",
        ),
    ],
)
def test_a_wrong_summary_is_refused(folder: Path, change: Callable[[dict[str, Any]], object], message: str) -> None:
    edit_summary(folder, change)
    text = complaint(folder)
    assert text.startswith("RUN/summary.json: ")
    assert message in text
    assert len(text) < 200


@pytest.mark.parametrize(
    ("content", "message"), [(b"seed 3", "not TOML"), (b"\xff", "this is not text"), (b"#" * 2**21, "larger than")]
)
def test_a_file_without_settings_is_refused(folder: Path, content: bytes, message: str) -> None:
    (folder / "experiment.toml").write_bytes(content)
    text = complaint(folder)
    assert text.startswith("RUN/experiment.toml: ")
    assert message in text


def test_an_error_that_is_not_that_of_the_steps_is_refused(folder: Path) -> None:
    first = Run(folder).checked().steps.of_iteration(0)
    rmse = float(np.sqrt(np.mean((first.next_state - first.target)[:, 0] ** 2)))
    edit_summary(folder, lambda content: content["iterations"][0]["rmse"].update(speed=rmse))
    assert Run(folder).checked().deployments[0].rmse[0] == rmse
    edit_summary(folder, lambda content: content["iterations"][0]["rmse"].update(speed=1e-6))
    text = complaint(folder)
    assert text.startswith("RUN/summary.json: rmse of speed of deployment 0 is 1e-06")
    assert f"that of its steps in steps.csv is {rmse:.6g}" in text


def test_byte_order_marks_of_steps_and_summary_do_no_harm(folder: Path) -> None:
    before = Run(folder).checked()
    for name in ("steps.csv", "summary.json"):
        (folder / name).write_text((folder / name).read_text(), encoding="utf-8-sig")
    after = Run(folder).checked()
    assert digest(after.steps) == digest(before.steps)
    assert after.shown_iterations == before.shown_iterations
    with StepWriter(folder / "steps.csv", before.space) as writer:
        assert len(writer.recorded) == len(before.steps)


def test_settings_that_are_gone_are_ignored_and_shown(folder: Path) -> None:
    (folder / "experiment.toml").write_text('[learning]\niterations = 2\nfeature_map = "identity"\n')
    run = Run(folder).checked()
    assert run.needed(run.settings) == Experiment(learning=LearningSettings(iterations=2))
    assert run.needed(run.settings_file).table["learning"] == {"iterations": 2, "feature_map": "identity"}


def test_directories_instead_of_files_are_refused(folder: Path) -> None:
    (folder / "experiment.toml").mkdir()
    assert "RUN/experiment.toml: not a file" in complaint(folder)


@pytest.mark.parametrize("content", ["", "\n", "\r\n\r\n"])
def test_a_step_log_without_steps_is_refused(folder: Path, content: str) -> None:
    (folder / "steps.csv").write_text(content)
    assert complaint(folder).startswith("RUN/steps.csv: no step yet; it must have a header and at least one row")


def test_steps_changed_after_the_summary(folder: Path) -> None:
    run = Run(folder).checked()
    edit_summary(folder, lambda content: content.update(steps_sha256=digest(run.steps)))
    assert Run(folder).checked().shown_iterations == run.shown_iterations
    path = folder / "steps.csv"
    path.write_text(path.read_text().replace(",0.0,0.0,nan,ok", ",0.0,0.5,nan,ok", 1))
    assert "RUN/summary.json: steps.csv was changed after it was written" in complaint(folder)


def test_too_many_coordinates(tmp_path: Path) -> None:
    names = tuple(f"x{number}" for number in range(steps_csv.MOST_COORDINATES + 1))
    assert "at most 100" in complaint(write_run(tmp_path / "run", names, steps=1))


def test_summary_of_another_robot(folder: Path) -> None:
    write_summary(folder, ("speed", "height"), 5, 2)
    assert "but it must have speed, tilt, as in steps.csv" in complaint(folder)


def test_every_fall_counts(tmp_path: Path) -> None:
    space = StepSpace((Quantity("x", "m", 0, 1),), (Quantity("push", "N", -1, 1),))
    with StepWriter(tmp_path / "steps.csv", space) as writer:
        writer.append(logged(0, 1, np.zeros(1), np.ones(1)))
        writer.append(logged(0, 2, np.zeros(1), np.ones(1), StepStatus.FELL))
    assert Run(tmp_path).checked().steps.failed_steps == 1


def test_an_unknown_part_is_refused(folder: Path) -> None:
    with pytest.raises(TypeError, match="a run has no part 'nominl'; its parts are settings, "):
        Run(folder, nominl=None)  # pyright: ignore[reportCallIssue]

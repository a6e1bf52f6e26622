"""The intact part of a damaged run folder can be reported, and resumed to the whole run."""

import json
import re
from pathlib import Path
from shutil import copytree

import pytest

from stepgap.base.errors import InputError
from stepgap.experiment.loop import Plants, Setup, run_experiment
from stepgap.experiment.resume import Recording
from stepgap.experiment.run import Run
from stepgap.learning.settings import LearningSettings
from stepgap.learning.steps import Steps
from stepgap.records import recovery
from stepgap.records.model_files import read_model
from stepgap.records.recovery import recover_file
from stepgap.records.steps_csv import RecordError
from tests.experiment.test_loop import NOMINAL, REALITY, REFERENCE, plant_of
from tests.full_disk import FILE_TOO_LARGE, largest_file

LEARNING = LearningSettings(iterations=2, early_stop=False)


def run(folder: Path) -> Path:
    folder.mkdir(exist_ok=True)
    run_experiment(Setup(NOMINAL, Plants(plant_of(REALITY)), REFERENCE, LEARNING, seed=3), folder)
    return folder


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return run(tmp_path_factory.mktemp("whole"))


def record(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def damaged(whole: Path, folder: Path, line: int) -> Path:
    """A copy of the run with a letter in a number of one line of its steps."""
    copytree(whole, folder)
    lines = (folder / "steps.csv").read_text().splitlines(keepends=True)
    lines[line] = lines[line].replace(".", ".x", 1)
    (folder / "steps.csv").write_text("".join(lines))
    return folder


@pytest.mark.parametrize("file", ["experiment.toml", "models/iteration_1.json", "steps.csv"])
def test_the_error_of_a_full_disk_names_the_new_file(whole: Path, tmp_path: Path, file: str) -> None:
    folder = damaged(whole, tmp_path / "run", len(REFERENCE) + 3)
    (folder / "experiment.toml").write_text("# " + 200 * "-")
    order = ["experiment.toml", "models/iteration_1.json", "summary.json", "steps.csv"]
    for written_before in order[: order.index(file)]:
        (folder / written_before).unlink()
    with largest_file(100), pytest.raises(InputError) as error:
        recover_file(folder, tmp_path / "out")
    assert str(error.value) == f"{tmp_path / 'out' / file}: {FILE_TOO_LARGE}"
    assert not (tmp_path / "out").exists(), "a retry finds the name free"


def test_a_damaged_run_is_recovered_reported_and_resumed(whole: Path, tmp_path: Path) -> None:
    line = len(REFERENCE) + 3  # in the second deployment
    folder = damaged(whole, tmp_path / "run", line)
    before = record(folder)
    with pytest.raises(RecordError, match=r"line \d+: not the next step .*; `stepgap recover` saves what comes before"):
        Run(folder, space=NOMINAL.space).checked()
    messages = recover_file(folder, tmp_path / "out")
    assert record(folder) == before
    assert f"line {line + 1}: not the next step" in messages[0]
    assert messages[-1] == f"{line - 1} steps recovered"
    found = Run(tmp_path / "out", space=NOMINAL.space).checked()
    assert [deployment.iteration for deployment in found.deployments] == [0]
    assert found.unfinished == {1: line - 1 - len(REFERENCE)}
    assert read_model(tmp_path / "out", 1, NOMINAL.space) is not None
    assert record(run(tmp_path / "out")) == record(whole)


def test_a_truncated_model_is_named_and_left_out(whole: Path, tmp_path: Path) -> None:
    folder = copytree(whole, tmp_path / "run")
    model = folder / "models" / "iteration_1.json"
    model.write_bytes(model.read_bytes()[:300])
    messages = recover_file(folder, tmp_path / "out")
    assert any("iteration_1.json: not a residual" in message and "left out" in message for message in messages)
    assert not (tmp_path / "out" / "models" / "iteration_1.json").exists()
    assert (tmp_path / "out" / "summary.json").read_bytes() == (whole / "summary.json").read_bytes()


@pytest.mark.parametrize(
    ("name", "content", "fault"),
    [
        ("experiment.toml", b"seed = ", "not TOML"),
        ("experiment.toml", b"\xff", "this is not text"),
        ("reference.csv", b"pace\n0.1\n", "line 1: the header is"),
        ("warm_start.csv", b"speed\n0.1\n", "line 1: the columns must be"),
        ("nominal_map.json", b"{", "Expecting property name"),
    ],
)
def test_a_damaged_input_is_named_and_copied(
    whole: Path, tmp_path: Path, name: str, content: bytes, fault: str
) -> None:
    folder = copytree(whole, tmp_path / "run")
    (folder / name).write_bytes(content)
    messages = recover_file(folder, tmp_path / "out")
    assert re.fullmatch(rf"{re.escape(str(folder / name))}(:|, line 1:) .*; copied as it is", messages[0])
    assert fault in messages[0]
    assert re.fullmatch(r"\d+ steps recovered", messages[1])
    assert (tmp_path / "out" / name).read_bytes() == content


def test_a_model_without_permission_is_named(whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def forbidden(*arguments: object) -> None:
        raise PermissionError(13, "Permission denied", "run/models/iteration_1.json")

    monkeypatch.setattr(recovery, "read_model", forbidden)
    messages = recover_file(whole, tmp_path / "out")
    assert "run/models/iteration_1.json: Permission denied; left out" in messages
    assert messages[-1].endswith("steps recovered")


def test_nothing_is_overwritten_and_other_folders_are_refused(whole: Path, tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    with pytest.raises(InputError, match="out: exists already"):
        recover_file(whole, tmp_path / "out")
    with pytest.raises(InputError, match=r"out: contains no steps\.csv; give the folder of a run"):
        recover_file(tmp_path / "out", tmp_path / "new")
    assert not (tmp_path / "new").exists()


def test_a_summary_of_another_version_is_neither_used_nor_replaced(whole: Path, tmp_path: Path) -> None:
    folder = copytree(whole, tmp_path / "run")
    summary = json.loads((folder / "summary.json").read_text())
    (folder / "summary.json").write_text(json.dumps({**summary, "schema": 99}))
    before = record(folder)
    with pytest.raises(RecordError, match=r"schema is 99, .* continue with the version of StepGap that wrote it"):
        Recording(folder, NOMINAL.space, 3, Steps(NOMINAL.space), replays=True)
    assert record(folder) == before

"""`stepgap sweep`: the same table by all ways of execution, after any process was killed, and clear errors."""

import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from time import sleep

import pytest
from hypothesis import given
from hypothesis import strategies as st

from stepgap.base.errors import InputError
from stepgap.cli.app import main
from stepgap.sweep.cases import execution
from stepgap.sweep.cases.execution import Processes
from stepgap.sweep.cli.execution import JOB_ARRAYS, Execution
from stepgap.sweep.results_table import read_results
from tests.cli.command_line import Command, refused
from tests.full_disk import FILE_TOO_LARGE, largest_file
from tests.quick_runs import compute_in_a_thread, leave_out_sweep_report

SWEEP = """
base = "short.toml"
seeds = [3]
keep = "runs"
[axes]
"gap.body_mass_scale" = [0.95, 1.05]
"learning.residual" = ["linear", "constant"]
"""

PROGRAM = [sys.executable, "-c", "from stepgap.cli.app import main; main()"]


def write_inputs(folder: Path) -> None:
    """Writes a sweep of four short experiments."""
    targets = "".join(f"{target}\n" for target in ["0,0.55"] + ["0.17,0.58"] * 2)
    (folder / "short.csv").write_text(f"speed,height\n{targets}")
    (folder / "short.toml").write_text('reference = "short.csv"\n[learning]\niterations = 1\n')
    (folder / "s.toml").write_text(SWEEP)


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a sweep of four short experiments."""
    monkeypatch.chdir(tmp_path)
    for name in JOB_ARRAYS:
        monkeypatch.delenv(name, raising=False)
    write_inputs(tmp_path)
    return tmp_path


@pytest.fixture(scope="module")
def one(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of the sweep, computed by this process."""
    folder = tmp_path_factory.mktemp("one")
    write_inputs(folder)
    with pytest.MonkeyPatch.context() as patch:
        compute_in_a_thread(patch)
        leave_out_sweep_report(patch)
        for name in JOB_ARRAYS:
            patch.delenv(name, raising=False)
        main(["sweep", str(folder / "s.toml"), "--out", str(folder / "one"), "--processes", "1", "--quiet"])
    return folder / "one"


@pytest.fixture
def table(here: Path, one: Path, in_a_thread: None, monkeypatch: pytest.MonkeyPatch) -> bytes:
    """The table of the sweep, whose folder is `one`; further sweeps are computed by this process."""
    leave_out_sweep_report(monkeypatch)
    shutil.copytree(one, "one")
    return Path("one/results.csv").read_bytes()


@pytest.fixture
def dask(here: Path) -> Iterator[str]:
    """Address of a dask scheduler with a worker, each a process that is reached over TCP."""
    start = [sys.executable, "-m", "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0"]
    worker = [sys.executable, "-m", "distributed.cli.dask_worker", "--nthreads", "1", "--no-nanny", "--no-dashboard"]
    processes = []
    try:
        with Path("dask.log").open("w") as log:
            scheduler = [*start, "--no-dashboard", "--scheduler-file", "dask.json"]
            processes.append(subprocess.Popen(scheduler, stdout=log, stderr=log))
            while not Path("dask.json").exists():
                assert processes[0].poll() is None, Path("dask.log").read_text()
                sleep(0.05)
            options = ["--scheduler-file", "dask.json", "--host", "127.0.0.1", "--local-directory", str(here)]
            processes.append(subprocess.Popen([*worker, *options], stdout=log, stderr=log))
        yield "dask.json"
    finally:
        for process in processes:
            process.kill()
            process.wait()


def test_all_ways_give_the_same_table(
    table: bytes, dask: str, stepgap: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patch:
        patch.setattr(execution, "Processes", Processes)
        result = stepgap("sweep", "s.toml", "--out", "two", "--processes", 2)
    assert (result.code, result.out.splitlines()[0]) == (0, "two/results.csv"), result.err
    assert Path("two/results.csv").read_bytes() == table
    for shard in (1, 2):
        result = stepgap("sweep", "s.toml", "--out", f"shard{shard}", "--shard", f"{shard}/2", "--processes", 1)
        assert (result.code, result.out) == (0, "")
        shutil.copytree(f"shard{shard}", "three", dirs_exist_ok=True)
    merged = stepgap("sweep", "--out", "three", "--resume")
    assert merged.code == 0, merged.err
    assert Path("three/results.csv").read_bytes() == table
    assert Path("three/runs/00000003/steps.csv").read_bytes() == Path("one/runs/00000003/steps.csv").read_bytes()
    result = stepgap("sweep", "s.toml", "--out", "four", "--dask", dask)
    assert result.code == 0, result.err
    assert Path("four/results.csv").read_bytes() == table


def test_the_table_has_the_numbers_of_single_runs(table: bytes, stepgap: Command, no_report: None) -> None:
    found = read_results(Path("one/results.csv"))
    assert found.settings == ("gap.body_mass_scale", "learning.residual", "seed")
    assert found.columns["case"].tolist() == [0, 0, 1, 1, 2, 2, 3, 3]
    assert found.columns["iteration"].tolist() == [0, 1] * 4
    settings = ["--gap.body_mass_scale", "1.05", "--learning.residual", "linear", "--seed", "3"]
    assert stepgap("run", "short.toml", *settings, "--out", "run").code == 0
    for name in ("steps.csv", "experiment.toml", "models/iteration_1.json"):
        assert Path("one/runs/00000002", name).read_bytes() == Path("run", name).read_bytes()


def test_shards_share_a_folder_and_the_last_one_writes_the_table(table: bytes, stepgap: Command) -> None:
    for index in (2, 1):
        result = stepgap("sweep", "s.toml", "--out", "shared", "--processes", 1, "--shard", f"{index}/2")
        assert result.code == 0, result.err
        assert Path("shared/results.csv").exists() == (index == 1)
    assert Path("shared/results.csv").read_bytes() == table


@given(st.integers(1, 50), st.integers(0, 300))
def test_every_case_is_in_exactly_one_shard(count: int, cases: int) -> None:
    parts = [list(Execution(shard=f"{index}/{count}").numbers(cases)) for index in range(1, count + 1)]
    assert sorted(number for part in parts for number in part) == list(range(cases))
    assert max(map(len, parts)) - min(map(len, parts)) <= 1


@pytest.mark.parametrize("text", ["", "0/3", "4/3", "1", "a/b", "1/3/5", "-1/3", "1.0/3", "1/ 3", "9" * 12 + "/1"])
def test_other_shards_are_refused(text: str) -> None:
    with pytest.raises(InputError, match="--shard"):
        Execution(shard=text).numbers(9)


@pytest.mark.parametrize("name", JOB_ARRAYS)
def test_a_task_of_a_job_array_needs_its_shard(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(name, "3")
    with pytest.raises(InputError, match=rf"--shard \${name}/N"):
        Execution().numbers(9)


def test_a_killed_sweep_continues_without_loss(table: bytes, stepgap: Command) -> None:
    client = subprocess.Popen([*PROGRAM, "sweep", "s.toml", "--out", "killed", "--processes", "2"])
    while not list(Path("killed").glob("cases/*/*.json")):
        assert client.poll() is None
        sleep(0.01)
    client.kill()
    client.wait()
    before = {path: path.stat().st_ino for path in Path("killed").glob("cases/*/*.json")}
    refused(stepgap("sweep", "s.toml", "--out", "killed"), "killed: already holds results of these cases", "--resume")
    result = stepgap("sweep", "--out", "killed", "--resume")
    assert result.code == 0, result.err
    assert Path("killed/results.csv").read_bytes() == table
    assert before.items() <= {path: path.stat().st_ino for path in Path("killed").glob("cases/*/*.json")}.items()


def test_a_case_that_cannot_run_is_recorded_with_its_reason(here: Path, stepgap: Command, in_a_thread: None) -> None:
    Path("s.toml").write_text('base = "short.toml"\nkeep = "nothing"\n[axes]\n"gains.rest_length" = [0.9, 0.285]')
    result = stepgap("sweep", "s.toml", "--out", "out", "--processes", 1)
    assert result.code == 0
    assert "case 0 failed: case 0: gains.rest_length = 0.9, but it must" in result.err
    found = read_results(Path("out/results.csv"))
    assert found.columns["case"].tolist() == [0, 1, 1]
    assert "gains.rest_length = 0.9" in found.columns["failed"][0]
    assert not Path("out/runs").exists()
    (failed,) = Path("out").glob("cases/*/00000000.json")
    before = failed.stat().st_mtime_ns
    assert stepgap("sweep", "--out", "out", "--resume").code == 0
    assert failed.stat().st_mtime_ns == before
    assert stepgap("sweep", "--out", "out", "--resume", "--retry-failed").code == 0
    assert failed.stat().st_mtime_ns > before


def test_a_full_disk_is_one_line_and_nothing_is_lost(here: Path, stepgap: Command) -> None:
    Path("s.toml").write_text(SWEEP.replace('"runs"', '"nothing"').replace("1.05, ", ""))
    with largest_file(900):
        result = stepgap("sweep", "s.toml", "--out", "out", "--processes", 1)
    assert (result.code, result.out) == (1, "") or result.code == 2
    assert result.err.count("\n") == 1
    assert FILE_TOO_LARGE in result.err
    Path("out").rename("full")
    assert not list(Path("full").rglob("*.partial"))


def test_the_plan_is_shown_without_running_it(here: Path, stepgap: Command) -> None:
    result = stepgap("sweep", "s.toml", "--plan")
    assert " ".join(result.out.split()) == "2 × gap.body_mass_scale 2 × learning.residual 1 × seed 4 cases"
    assert sorted(path.name for path in here.iterdir()) == ["s.toml", "short.csv", "short.toml"]


def test_bad_input_is_one_line_and_writes_nothing(here: Path, stepgap: Command) -> None:
    for path in ("used", "other"):
        Path(path).mkdir()
    Path("used/notes.txt").write_text("mine")
    Path("other/sweep.toml").write_text("keep = 'runs'")
    sweep = ("sweep", "s.toml", "--out")
    refused(stepgap("sweep"), "SWEEP.toml: missing")
    refused(stepgap("sweep", "none.toml"), "none.toml")
    refused(stepgap("sweep", "--out", "none", "--resume"), "none: contains no sweep.toml")
    refused(stepgap(*sweep, "used"), "used: holds other files, such as notes.txt")
    refused(stepgap(*sweep, "other"), "other/sweep.toml: already there, but of other cases")
    refused(stepgap(*sweep, "x", "--shard", "4/3"), "--shard 4/3: must be I/N")
    refused(stepgap("sweep", "s.toml", "--shard", "1/3"), "--shard: give --out")
    refused(stepgap(*sweep, "x", "--shard", "1/3", "--dask", "local"), "give only one of them")
    refused(stepgap(*sweep, "x", "--processes", 0), "processes")
    refused(stepgap(*sweep, "x", "--dask", "none.json"), "none.json: no such file")
    refused(stepgap(*sweep, "s.toml"), "s.toml")
    assert [path.name for folder in ("used", "other") for path in Path(folder).iterdir()] == ["notes.txt", "sweep.toml"]
    assert not Path("x/cases").exists()
    assert (Path("used/notes.txt").read_text(), Path("other/sweep.toml").read_text()) == ("mine", "keep = 'runs'")

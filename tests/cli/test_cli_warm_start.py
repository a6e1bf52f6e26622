"""`stepgap run --warm-start` and `--json`: the steps taken from another run, and the events for programs."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from stepgap.cli.app import main
from stepgap.robots.hopper.parameters import CommandBounds
from tests.cli.command_line import Command, CommandResult, refused
from tests.quick_runs import leave_out_repeats, leave_out_report

TARGETS = "speed,height\n" + 3 * "0.1,0.56\n" + 5 * "0.25,0.6\n"


pytestmark = pytest.mark.usefixtures("no_repeats", "no_report")


@pytest.fixture(scope="module")
def cold(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a run of two deployments in `run`."""
    folder = tmp_path_factory.mktemp("cold")
    (folder / "targets.csv").write_text(TARGETS)
    with pytest.MonkeyPatch.context() as patch:
        leave_out_repeats(patch)
        leave_out_report(patch)
        reference = ["--reference", str(folder / "targets.csv")]
        main(["run", *reference, "--iterations", "1", "--out", str(folder / "run"), "--seed", "5", "--quiet"])
    return folder


def error(entry: dict) -> float:
    """Tracking error of both coordinates together, in half ranges."""
    rmse = [entry["rmse"][quantity.name] for quantity in CommandBounds().space().state]
    return float(np.linalg.norm(rmse / CommandBounds().space().state_scale))


def entries(run: Path) -> list[dict]:
    return json.loads((run / "summary.json").read_text())["iterations"]


def test_a_warm_start_is_far_better_and_its_folder_is_complete(cold: Path, stepgap: Command) -> None:
    arguments = ["--reference", cold / "targets.csv", "--iterations", 0, "--quiet", "--out"]
    result = stepgap("run", *arguments, "warm", "--seed", 8, "--warm-start", cold / "run")
    assert result == CommandResult(0, "warm/report.html\n", "")
    first, (warm,) = entries(cold / "run")[0], entries(Path("warm"))
    assert (first["residual"], warm["residual"]) == ("none", "posterior")
    assert error(warm) < 0.5 * error(first)
    assert Path("warm/warm_start.csv").read_bytes() == (cold / "run" / "steps.csv").read_bytes()
    assert 'warm_start = "warm_start.csv"\n' in Path("warm/experiment.toml").read_text()

    assert stepgap("run", "warm/experiment.toml", "--out", "again", "--quiet").code == 0
    names = ("experiment.toml", "steps.csv", "summary.json", "warm_start.csv", "models/iteration_0.json")
    assert all(Path("again", name).read_bytes() == Path("warm", name).read_bytes() for name in names)

    lines = Path("again/steps.csv").read_text().splitlines(keepends=True)
    Path("again/steps.csv").write_text("".join(lines[:5]))
    Path("again/summary.json").unlink()
    assert stepgap("run", "--resume", "--out", "again", "--quiet").code == 0
    assert all(Path("again", name).read_bytes() == Path("warm", name).read_bytes() for name in names)


def test_known_steps_of_the_other_run_are_passed_on(cold: Path, stepgap: Command) -> None:
    short = Path("short.csv")
    short.write_text("speed,height\n0.1,0.56\n")
    arguments = ["--reference", short, "--iterations", 0, "--quiet", "--out"]
    stepgap("run", *arguments, "second", "--warm-start", cold / "run")
    stepgap("run", *arguments, "third", "--warm-start", "second")
    known = Path("third/warm_start.csv").read_text().splitlines()
    own = Path("second/steps.csv").read_text().splitlines()[1:]
    assert known[:-2] == (cold / "run" / "steps.csv").read_text().splitlines()
    assert known[-2:] == ["3" + row[1:] for row in own], "a number is left out between the runs"


@pytest.mark.parametrize(
    ("other", "parts"),
    [
        ("nowhere", ["nowhere: No such file or directory; a warm start needs the folder of a run"]),
        ("empty", ["empty/steps.csv: No such file or directory; a warm start needs"]),
        ("foreign", ["foreign/steps.csv, line 1: the columns must be iteration,step,speed", "of the same state"]),
        ("binary", ["binary/steps.csv: not a text file in UTF-8"]),
        ("header.csv", ["header.csv: no step yet; a warm start needs"]),
        ("damaged.csv", ["damaged.csv, line 4: not the next step"]),
    ],
)
def test_a_warm_start_without_a_run_is_refused(cold: Path, stepgap: Command, other: str, parts: list[str]) -> None:
    text = (cold / "run" / "steps.csv").read_text()
    for folder in ("empty", "foreign", "binary"):
        Path(folder).mkdir()
    Path("foreign/steps.csv").write_text(text.replace("speed", "pace"))
    Path("binary/steps.csv").write_bytes(b"\xff\xfe\x00\n")
    Path("header.csv").write_text(text[: text.index("\n") + 1])
    Path("damaged.csv").write_text(text.replace("\n0,2,", "\n0,3,"))
    before = sorted(Path().rglob("*"))
    refused(stepgap("run", "--out", "run", "--warm-start", other), *parts)
    assert sorted(Path().rglob("*")) == before


def test_events_are_printed_as_json_lines(stepgap: Command) -> None:
    Path("short.csv").write_text("speed,height\n0.1,0.56\n0.2,0.58\n")
    result = stepgap("run", "--reference", "short.csv", "--iterations", 1, "--out", "run", "--json")
    assert result.code == 0
    events = [json.loads(line) for line in result.out.splitlines()]
    kinds = [each.pop("event") for each in events]
    assert kinds == [*3 * ["step"], "deployment", *3 * ["step"], "deployment", "report"]
    assert events[-1] == {"path": "run/report.html"}
    assert [events[3], events[7]] == entries(Path("run"))
    header, *rows = Path("run/steps.csv").read_text().splitlines()
    steps = [each for kind, each in zip(kinds, events, strict=True) if kind == "step"]
    assert [",".join(map(str, step.values())).replace("None", "nan") for step in steps] == rows
    assert ",".join(steps[0]) == header
    assert [line.split(" (")[0] for line in result.err.splitlines()] == ["deployment 0 of 1", "deployment 1 of 1"]


def test_of_many_runs_each_is_known(cold: Path, stepgap: Command) -> None:
    fleet = Path("fleet")
    for name in ("first", "second"):
        shutil.copytree(cold / "run", fleet / name)
    (fleet / "latest").symlink_to("second")
    short = Path("short.csv")
    short.write_text("speed,height\n0.1,0.56\n")
    stepgap("run", "--reference", short, "--iterations", 0, "--quiet", "--out", "warm", "--warm-start", fleet)
    header, *rows = (cold / "run" / "steps.csv").read_text().splitlines()
    count = 1 + max(int(row.split(",")[0]) for row in rows)
    again = [f"{int(row.split(',')[0]) + count + 1}," + row.split(",", 1)[1] for row in rows]
    assert Path("warm/warm_start.csv").read_text().splitlines() == [header, *rows, *again]

    finished = Path("warm/steps.csv").read_bytes()
    Path("warm/steps.csv").write_bytes(finished[: finished.index(b"\n") + 1])
    Path("warm/summary.json").unlink()
    assert stepgap("run", "--resume", "--out", "warm", "--quiet").code == 0
    assert Path("warm/steps.csv").read_bytes() == finished
    assert (
        stepgap("run", "--reference", short, "--iterations", 0, "--quiet", "--out", "next", "--warm-start", "warm").code
        == 0
    )

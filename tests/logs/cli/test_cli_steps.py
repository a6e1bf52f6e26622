"""`stepgap steps`: its files, which `stepgap fit` reads; what it leaves out and refuses; and wrong input."""

import csv
import sys
from pathlib import Path

import numpy as np
import pytest

from stepgap.logs.columns import read_columns
from tests.cli.command_line import Command, refused
from tests.full_disk import largest_file
from tests.logs.sections.hopping_logs import HoppingLog, hopping, lost_rows, write

STATE = ("--state", "speed=rate(forward),height")
APEXES = ("--height", "height", *STATE, "--command", "number")


@pytest.fixture
def log(tmp_path: Path, stepgap: Command) -> HoppingLog:
    """log.csv and plan.csv in the current folder, with two gaps."""
    assert stepgap
    rng = np.random.default_rng(0)
    made = lost_rows(2, 0.2)(hopping(30, rng, 500.0), rng)
    write(made, tmp_path, rng)
    return made


def rows_of(file: str) -> list[dict[str, str]]:
    with Path(file).open(newline="") as stream:
        return list(csv.DictReader(stream))


@pytest.mark.usefixtures("drawn_page")
def test_it_writes_steps_their_meaning_and_a_figure(log: HoppingLog, stepgap: Command) -> None:
    Path("units.toml").write_text('[units]\nforward = "m"\nheight = "m"\n')
    result = stepgap("steps", "log.csv", "--plan", "plan.csv", *APEXES, "--columns", "units.toml", "--out", "steps.csv")
    assert result.code == 0, result
    lines = result.out.splitlines()
    assert lines[0].startswith("log.csv: 30 sections, ")
    assert any(line.startswith("  left out: ") for line in lines)
    assert lines[-3:] == ["steps.csv", "steps.toml", "steps.png"]
    assert "stepgap fit steps.csv --columns steps.toml" in result.err
    assert Path("steps.png").read_bytes().startswith(b"\x89PNG")
    rows = rows_of("steps.csv")
    found = np.array([[float(row[name]) for name in ("speed", "height", "next_speed", "next_height")] for row in rows])
    numbers = [int(row["number"]) for row in rows]
    np.testing.assert_allclose(found, np.hstack([log.apexes[numbers, 1:], log.apexes[1:][numbers, 1:]]), atol=1e-4)
    assert [int(row["step"]) for row in rows] == [number + 1 for number in numbers]
    columns = read_columns(Path("steps.toml"), {})
    assert columns is not None
    assert (columns.state, columns.next, columns.command, columns.deployment) == (
        ("speed", "height"), ("next_speed", "next_height"), ("number",), "log",
    )  # fmt: skip
    assert columns.units == {"speed": "m/s", "height": "m"}


@pytest.mark.skipif(sys.platform == "darwin", reason="names of files are UTF-8 there")
@pytest.mark.parametrize(
    ("name", "label"),
    [("l\udcff.csv", "l\ufffd.csv"), ("a\nb.csv", "a\ufffdb.csv"), ("=cmd().csv", "'=cmd().csv")],
)
def test_a_log_may_have_any_name(name: str, label: str, log: HoppingLog, stepgap: Command) -> None:
    assert log
    Path("log.csv").rename(name)
    assert stepgap("steps", name, "--plan", "plan.csv", *APEXES, "--out", "steps.csv").code == 0
    assert {row["log"] for row in rows_of("steps.csv")} == {label}


@pytest.mark.parametrize(("name", "typed"), [("./-x.csv", "./-x.csv --columns ./-x.toml"), ("a b.csv", "'a b.csv'")])
def test_the_next_command_can_be_typed(name: str, typed: str, log: HoppingLog, stepgap: Command) -> None:
    assert log
    result = stepgap("steps", "log.csv", "--plan", "plan.csv", *APEXES, "--out", name)
    assert f"stepgap fit {typed}" in result.err


def test_fit_reads_the_steps(log: HoppingLog, stepgap: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("stepgap.learning.entry_points.names_by_complexity", lambda: ("none", "constant"))
    assert stepgap("steps", "log.csv", "--plan", "plan.csv", *APEXES, "--out", "steps.csv").code == 0
    result = stepgap("fit", "steps.csv", "--columns", "steps.toml", "--nominal", "state")
    assert result.code == 0, result
    assert f"steps       {len(rows_of('steps.csv'))} of 1 deployment" in result.out
    assert len(log.apexes) == 30


@pytest.mark.usefixtures("drawn_page")
def test_several_logs_are_told_apart(log: HoppingLog, stepgap: Command) -> None:
    Path("second").mkdir()
    write(log, Path("second"), np.random.default_rng(1))
    logs = ("log.csv", "second/log.csv", "--plan", "plan.csv", "--plan", "second/plan.csv")
    assert stepgap("steps", *logs, *APEXES, "--out", "steps.csv", "--plot", "figure.svg").code == 0
    labels = [row["log"] for row in rows_of("steps.csv")]
    assert sorted(set(labels)) == ["log.csv (1)", "log.csv (2)"]
    assert labels.count("log.csv (1)") == labels.count("log.csv (2)") > 20
    assert b"second/log.csv" not in Path("figure.svg").read_bytes()


@pytest.mark.filterwarnings("always::stepgap.base.errors.StepGapWarning")
def test_episodes_in_one_file_are_told_apart(stepgap: Command) -> None:
    """Times begin anew in each; one without hops is left out, and named."""
    rows, plans = ["trial,time,height"], ["trial,time,push"]
    for trial in range(3):
        made = hopping(8, np.random.default_rng(trial), 200.0)
        rows += [
            f"{trial},{time},{height if trial != 1 else 0.5}"
            for time, height in zip(made.time, made.height, strict=True)
        ]
        plans += [f"{trial},{time + 0.01},{trial}" for time in made.apexes[:, 0]]
    Path("log.csv").write_text("\n".join(rows))
    Path("plan.csv").write_text("\n".join(plans))
    apexes = ("--height", "height", "--state", "height", "--command", "push")
    refused(stepgap("steps", "log.csv", *apexes, "--out", "steps.csv"), "the time goes back from", "to 0.00")
    found = stepgap("steps", "log.csv", "--plan", "plan.csv", *apexes, "--deployment", "trial", "--out", "steps.csv")
    assert found.code == 0, found
    assert "left out: log.csv, 1" in found.err
    labels = [(row["log"], row["push"]) for row in rows_of("steps.csv")]
    assert labels == [("log.csv 0", "0")] * 7 + [("log.csv 2", "2")] * 7


def test_times_since_1970_and_small_numbers_are_written_without_loss(stepgap: Command) -> None:
    made = hopping(8, np.random.default_rng(0), 200.0)
    height = 1e-9 * made.height
    rows = [f"{1.7e9 + time!r},{value!r}" for time, value in zip(made.time.tolist(), height.tolist(), strict=True)]
    Path("log.csv").write_text("time,height\n" + "\n".join(rows))
    assert stepgap("steps", "log.csv", "--height", "height", "--state", "height", "--out", "steps.csv").code == 0
    found = rows_of("steps.csv")
    times = np.array([float(row["time"]) - 1.7e9 for row in found])
    np.testing.assert_allclose(times, made.apexes[:7, 0], atol=1e-3)
    assert all(len(row["height"]) > 18 for row in found)
    assert [row["next_height"] for row in found[:-1]] == [row["height"] for row in found[1:]]


def test_a_joint_that_rests_in_most_hops_is_no_doubt(stepgap: Command) -> None:
    """Between its few motions, it has rounding errors of 1e-16 only."""
    rng = np.random.default_rng(0)
    made = hopping(30, rng, 500.0)
    knee, still = 1e-16 * rng.normal(size=len(made.time)), np.full(len(made.time), 1e-12)
    for number, (time, *_) in enumerate(made.apexes.tolist()):
        near = np.abs(made.time - time) < 0.12
        if number % 3 == 0:
            knee[near] += rng.uniform(0.5, 1.5) + 0.02 * rng.normal(size=int(near.sum()))
    table = np.column_stack([made.time, made.height, knee, still])
    np.savetxt("log.csv", table, delimiter=",", header="time,height,knee,still", comments="", fmt="%.17g")
    state = ("--state", "height,knee,still")
    assert stepgap("steps", "log.csv", "--height", "height", *state, "--out", "steps.csv").code == 0
    assert len(rows_of("steps.csv")) >= 27


def test_a_doubtful_log_is_refused_after_its_figure(log: HoppingLog, stepgap: Command) -> None:
    Path("plan.csv").write_text("time,number\n99,1\n")
    result = stepgap("steps", "log.csv", "--plan", "plan.csv", *APEXES, "--out", "steps.csv")
    assert result.code == 2
    assert result.err == (
        "stepgap: log.csv: no step can be used, most often: no plan. steps.png shows them; nothing else was written\n"
    )
    assert sorted(path.name for path in Path().iterdir()) == ["log.csv", "plan.csv", "steps.png"]
    assert len(log.apexes) == 30


@pytest.mark.usefixtures("drawn_page")
@pytest.mark.parametrize("form", ["png", "pdf", "svg"])
def test_the_figure_of_a_refused_log_is_replaced_by_that_of_the_next(
    form: str, log: HoppingLog, stepgap: Command
) -> None:
    command = ("steps", "log.csv", "--plan", "plan.csv", *APEXES, "--out", "steps.csv", "--plot", f"figure.{form}")
    plan = Path("plan.csv").read_text()
    Path("plan.csv").write_text("time,number\n99,1\n")
    assert stepgap(*command).code == 2
    refused_figure = Path(f"figure.{form}").read_bytes()
    assert stepgap(*command).code == 2
    Path("plan.csv").write_text(plan)
    assert stepgap(*command).code == 0
    assert Path(f"figure.{form}").read_bytes() != refused_figure
    Path("steps.csv").unlink()
    Path("steps.toml").unlink(missing_ok=True)
    refused(stepgap(*command), f"figure.{form}: exists already")
    assert len(log.apexes) == 30


WRONG = [
    ((*APEXES,), ("LOG: none given; give logs of the robot's motion",)),
    (("log.csv", *STATE), ("--height = ''", "it must be the column of the height")),
    (("log.csv", "--height", "height"), ("--state = ''",)),
    (("log.csv", "--height", "hieght", *STATE), ("log.csv: no column 'hieght'; did you mean 'height'?",)),
    (("gone.csv", *APEXES), ("gone.csv: No such file or directory",)),
    (("log.csv", "--plan", "log.csv", "--plan", "plan.csv", *APEXES), ("--plan: 2 files for 1 logs",)),
    (("log.csv", *APEXES), ("log.csv: no column 'number'",)),
    (("log.csv", "--columns", "gone.toml"), ("gone.toml: No such file or directory",)),
    (("log.csv", "--force", "height", *APEXES), ("log.csv, column 'height': from 0.", "subtract the offset")),
    (("log.csv", "--phase", "phase", "--aerial", "AIR", *APEXES), ("no phase 'AIR'; there is FLIGHT, STANCE",)),
    (("log.csv", "--contact", "force", *APEXES), ("a contact must be 0 or 1; use it as a --force",)),
    (("log.csv", *APEXES, "--plot", "figure.gif"), ("figure.gif: the name must end with one of .pdf, .png, .svg",)),
]


@pytest.mark.usefixtures("log")
def test_wrong_input_is_refused(stepgap: Command) -> None:
    for arguments, parts in WRONG:
        refused(stepgap("steps", *arguments, "--out", "steps.csv"), *parts)
    assert not Path("steps.csv").exists()


@pytest.mark.usefixtures("log")
def test_on_a_full_disk_nothing_is_left_of_the_outputs(stepgap: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    """Not a table without its figure either, which would be in the way of the next try."""
    monkeypatch.setattr("stepgap.logs.sections.section_figures.sections_picture", lambda *_: bytes(100_000))
    with largest_file(90_000):
        result = stepgap("steps", "log.csv", "--plan", "plan.csv", *APEXES, "--out", "steps.csv")
    assert result.code == 2
    assert "steps.png: cannot be written: File too large" in result.err
    assert not list(Path().glob("*steps*"))


@pytest.mark.usefixtures("log")
def test_nothing_is_overwritten(stepgap: Command) -> None:
    for taken in map(Path, ("steps.csv", "steps.toml", "steps.png")):
        taken.write_text("mine")
        refused(stepgap("steps", "log.csv", *APEXES, "--out", "steps.csv"), f"{taken}: exists already")
        assert taken.read_text() == "mine"
        assert list(Path().glob("steps.*")) == [taken]
        taken.unlink()

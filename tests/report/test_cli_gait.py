"""`stepgap gait` for single steps: one, many rows, a table of commands."""

import re
from pathlib import Path

import numpy as np
import pytest

from stepgap.robots.hopper import Gains
from stepgap.robots.hopper.model.apex_map import ApexMap
from tests.cli.command_line import Command, refused

HEADER = "speed,height,fx,fy\n"


def numbers(text: str) -> list[float]:
    return [float(word) for word in re.findall(r"[-+]?\d+\.?\d*(?:e[-+]?\d+)?", text)]


def test_one_step_and_its_derivatives(stepgap: Command) -> None:
    result = stepgap("gait", "--state", "speed=0.1,height=0.56", "--command", "fx=-3,fy=2.5")
    assert (result.code, result.err) == (0, "")
    state, command, first, _, header, *rows = result.out.splitlines()
    apex_map = ApexMap()
    assert (numbers(state), numbers(command)) == ([0.1, 0.56], [-3, 2.5])
    assert numbers(first) == pytest.approx(apex_map([0.1, 0.56], [-3, 2.5]), abs=1e-6)
    assert [word for word in ("speed", "height", "fx", "fy") if f"by {word} [" in header] == [
        *apex_map.space.state_names,
        *apex_map.space.command_names,
    ]
    found = np.array([numbers(row.partition("]")[2]) for row in rows])
    np.testing.assert_allclose(found, apex_map.jacobian([0.1, 0.56], [-3, 2.5]), rtol=1e-5)


def test_settings_change_the_map(stepgap: Command) -> None:
    Path("soft.toml").write_text("[gains]\nstiffness = 2400\n")
    expected = ApexMap(gains=Gains(stiffness=2400))([0.2, 0.58], [0, 0])
    for arguments in (["soft.toml"], ["--gains.stiffness", "2400"]):
        result = stepgap("gait", *arguments, "--command", "fx=0")
        assert result.code == 0
        assert numbers(result.out.splitlines()[2]) == pytest.approx(expected, abs=1e-6)


def test_a_value_that_is_not_given_is_shown(stepgap: Command) -> None:
    state, command, *_ = stepgap("gait", "--state", "speed=0.1", "--command", "fx=0").out.splitlines()
    assert state.split() == ["state", "speed", "0.100000", "m/s,", "height", "0.580000", "m"]
    assert command.split() == ["command", "fx", "0.000000", "N,", "fy", "0.000000", "N"]


def test_a_failed_step_has_a_reason(stepgap: Command) -> None:
    result = stepgap("gait", "--state", "height=0.2", "--command", "fx=0")
    refused(result, "height 0.200000 m, fx 0.000000 N, ", "(foot_scuffed: ", "choose a higher apex")


ROWS = "fy, speed,height,fx\n0,0.2,0.58,0\n\n2,0.1,0.2,1\n-1e1,0.3,0.6,0.5\n"


@pytest.mark.parametrize("out", [None, "next.csv"])
def test_many_rows(stepgap: Command, out: str | None) -> None:
    Path("points.csv").write_text(ROWS)
    result = stepgap("gait", "--csv", "points.csv", *(["--out", out] if out else []))
    assert (result.code, result.err) == (0, "")
    if out:
        assert result.out == "next.csv\n"
    header, *rows = (Path(out).read_text() if out else result.out).splitlines()
    assert header == "speed,height,fx,fy,next_speed,next_height,status"
    assert [row.split(",")[-1] for row in rows] == ["ok", "foot_scuffed", "ok"]
    first = [float(cell) for cell in rows[0].split(",")[:-1]]
    assert first == [0.2, 0.58, 0, 0, *ApexMap()([0.2, 0.58], [0, 0])]
    assert rows[1].startswith("0.1,0.2,1.0,2.0,nan,nan,")
    assert rows[2].startswith("0.3,0.6,0.5,-10.0,")


def test_a_table(stepgap: Command) -> None:
    result = stepgap(
        "gait", "--table", "table.npz", "--points", 3, "--gains.stiffness", "2400", "--command.fy_upper", "18"
    )
    assert (result.code, result.err) == (0, "")
    assert result.out.endswith("\ntable.npz\n")
    assert "81 commands" in result.out
    with np.load("table.npz", allow_pickle=False) as table:
        arrays = dict(table)
    assert arrays["names"].tolist() == ["speed", "height", "fx", "fy"]
    assert arrays["ranges"][:, 1].tolist() == [0.4, 0.64, 30, 18]
    commands = arrays["commands"]
    assert commands.shape == (3, 3, 3, 3, 2)
    apex_map = ApexMap(gains=Gains(stiffness=2400))
    works = np.isfinite(commands).all(axis=-1)
    speed = np.linspace(0, 0.4, 3)
    height = np.linspace(0.52, 0.64, 3)
    states = np.stack(np.meshgrid(speed, height, speed, height, indexing="ij"), axis=-1)[..., :2]
    predicted = apex_map.evaluate(states[works], commands[works]).next_state
    np.testing.assert_allclose(predicted, arrays["predicted"][works], atol=1e-9)


@pytest.mark.parametrize(
    ("arguments", "parts"),
    [
        ("gait --state speed=nan", ["--state speed=nan: it must be names, each once, with finite numbers"]),
        (
            "gait --command fx=strong",
            ["--command fx=strong: it must be names, each once, with finite numbers, such as fx=0,fy=0"],
        ),
        ("gait --gains.stifness 3", ["--gains.stifness: unknown key; did you mean stiffness?"]),
        ("gait none.toml", ["none.toml: No such file or directory"]),
        ("gait --csv good.csv --state speed=0.1", ["--csv and --state: give only one of them"]),
        ("gait --csv good.csv --table t.npz", ["--csv and --table: give only one of them"]),
        ("gait --command fx=0 --out next.png", ["--out: valid only for the figure, and with --csv"]),
        ("gait --points 5", ["--points 5: valid only with --table"]),
        ("gait --quiet", ["--quiet: valid only with --table"]),
        ("gait --table t.npz --points 1", ['Invalid value "1" for --points. Must be >= 2']),
        ("gait --table t.npz --points 1.5", ["--points", "1.5"]),
        (
            "gait --table good.csv --points 2",
            ["good.csv: exists already; choose another --table"],
        ),
        ("gait --table none/t.npz --points 2", ["none/t.npz: cannot be written", "choose another --table"]),
        (
            "gait --csv good.csv --out good.csv",
            ["good.csv: exists already; choose another --out"],
        ),
        ("gait --csv good.csv --out none/n.csv", ["none/n.csv: cannot be written", "choose another --out"]),
        ("gait --nominal.kind log --nominal.file none.csv", ["stepgap: nominal.file: none.csv: No such file"]),
        ("gait --csv none.csv", ["none.csv: No such file or directory; it must be a CSV file with the columns"]),
        ("gait --csv folder", ["folder: Is a directory; it must be a CSV file"]),
        ("gait --csv empty.csv", ["empty.csv, line 1: the header is ''; it must be 'speed,height,fx,fy'"]),
        ("gait --csv header.csv", ["header.csv, line 2: there is no point"]),
        ("gait --csv names.csv", ["names.csv, line 1: the header is 'speed,height,fx,f'; it must be"]),
        ("gait --csv short.csv", ["short.csv, line 3: 3 values; it must have 4, one for each of speed,height,fx,fy"]),
        ("gait --csv word.csv", ["word.csv, line 2, column 'fx': 'strong'; it must be a finite number in N, for"]),
        ("gait --csv nan.csv", ["nan.csv, line 2, column 'height': 'nan'; it must be a finite number in m, for"]),
        ("gait --csv binary.csv", ["binary.csv: this is not text; it must be a CSV file"]),
        ("gait --csv quote.csv", ["quote.csv, line 2: "]),
    ],
)
def test_bad_input_is_refused_in_one_line(stepgap: Command, arguments: str, parts: list[str]) -> None:
    Path("folder").mkdir()
    texts = {
        "good": HEADER + "0.2,0.58,0,0\n",
        "empty": "",
        "header": HEADER,
        "names": "speed,height,fx,f\n1,1,1,1\n",
        "short": HEADER + "0.2,0.58,0,0\n0.2,0.58,0\n",
        "word": HEADER + "0.2,0.58,strong,0\n",
        "nan": HEADER + "0.2,nan,0,0\n",
        "quote": HEADER + '0.2,0.58,0,"0\n',
    }
    for name, text in texts.items():
        Path(f"{name}.csv").write_text(text)
    Path("binary.csv").write_bytes(b"\xff\xfe\x00")
    before = {path: path.read_bytes() for path in Path().glob("*.csv")}
    refused(stepgap(*arguments.split()), *parts)
    assert {path: path.read_bytes() for path in Path().iterdir() if path.is_file()} == before


def test_help(stepgap: Command) -> None:
    result = stepgap("gait", "--help")
    assert (result.code, result.err) == (0, "")
    for word in ("--csv", "--table", "--points", "speed=0.2,height=0.58", "fx=5,fy=-5"):
        assert word in result.out

"""`examples/apexes_from_log.py` finds the apexes of a synthetic log."""

import csv
import runpy
from io import StringIO
from pathlib import Path

import numpy as np
import pytest

EXAMPLE = Path(__file__).parents[1] / "examples" / "apexes_from_log.py"
TICK, GRAVITY, BOOM = 0.005, 5.2, 1.8


def made_log(hops: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Speeds and heights of ballistic hops, and their log: time, height, forward."""
    rng = np.random.default_rng(0)
    speeds, rises, rows, start = rng.uniform(0.1, 0.4, hops), rng.uniform(0.05, 0.1, hops), [], 0.0
    for speed, rise in zip(speeds, rises, strict=True):
        take_off = np.sqrt(2 * GRAVITY * rise)
        since = np.arange(0, 2 * take_off / GRAVITY, TICK)
        height = 0.5 + take_off * since - GRAVITY / 2 * since**2
        rows.append(np.stack([np.zeros_like(since), height, start + speed * since], axis=-1))
        start = rows[-1][-1, 2]
    log = np.concatenate(rows)
    log[:, 0] = TICK * np.arange(len(log))
    return speeds, 0.5 + rises, log


def write(path: str, names: str, rows: np.ndarray) -> None:
    Path(path).write_text("\n".join([names, *(",".join(map(repr, row)) for row in rows.tolist())]) + "\n")


@pytest.mark.parametrize("boom", [False, True])
def test_apexes_are_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], boom: bool
) -> None:
    monkeypatch.chdir(tmp_path)
    speeds, heights, log = made_log(8)
    if boom:
        log[:, 1], log[:, 2] = np.arcsin(log[:, 1] / BOOM), log[:, 2] / BOOM
    write("clock.csv", "t,forward", log[:, [0, 2]])
    write("body.csv", "y", log[:, [1]])
    Path("plan.csv").write_text("v,note\n" + "".join(f"[{number} 7],x\n" for number in range(8)))
    options = ["--time", "t", "--height", "y", "--plan", "plan.csv", "--plan-columns", "v"]
    options += ["--boom", str(BOOM)] if boom else []
    runpy.run_path(str(EXAMPLE))["main"](["clock.csv", "body.csv", *options])
    rows = list(csv.DictReader(StringIO(capsys.readouterr().out)))
    names = ("speed", "height", "next_speed", "next_height", "v")
    found = np.array([[float(row[name]) for name in names] for row in rows])
    expected = [speeds[:-1], heights[:-1], speeds[1:], heights[1:], np.arange(1.0, 8)]
    np.testing.assert_allclose(found, np.stack(expected, axis=-1), atol=2e-5)


def test_plans_must_be_as_many_as_hops(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    write("log.csv", "time,height,forward", made_log(3)[2])
    Path("plan.csv").write_text("v\n1\n")
    with pytest.raises(SystemExit, match="1 plans of 3 hops"):
        runpy.run_path(str(EXAMPLE))["main"](["log.csv", "--plan", "plan.csv", "--plan-columns", "v"])

"""`benchmarks.speed gp`: it runs and reports its measurements; no test checks the times."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from benchmarks import compare_gaussian_processes
from benchmarks.peers import gaussian_processes
from benchmarks.speed import gaussian_process as bench_gp
from benchmarks.speed.__main__ import speed_line
from tests.cli.command_line import Command, refused


@pytest.fixture(autouse=True)
def tiny(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        bench_gp, "QUICK_GP_BENCH", bench_gp.GpBenchSize(points=(30, 40), rounds=(1, 1), calls=2, queries=50)
    )
    monkeypatch.setattr(bench_gp, "MANY_STARTS_SIZE", 30)


def test_the_quick_bench_writes_json_and_a_table(stepgap: Command) -> None:
    command_result = stepgap("gp", "--quick", verbs=speed_line)
    assert command_result.code == 0, command_result.err
    assert command_result.out.endswith("\nbench_gp.json\n")
    for line in (" +30  StepGap ", " +40  StepGap, linear basis "):
        assert re.search(f"^{line}", command_result.out, re.MULTILINE), line
    result = json.loads(Path("bench_gp.json").read_text())
    assert {row["name"] for row in result["rows"]} == {"StepGap", "StepGap, linear basis"}
    assert result["skipped"] == {}


def test_the_comparison_measures_peers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.argv", ["compare.py", "--quick", "--out", str(tmp_path / "gp.json")])
    compare_gaussian_processes.main()
    out = capsys.readouterr().out
    for line in (" +30  StepGap ", " +40  scikit-learn ", " +GPyTorch +skipped"):
        assert re.search(f"^{line}", out, re.MULTILINE), line
    result = json.loads((tmp_path / "gp.json").read_text())
    assert result.keys() == {"schema", "quick", "seed", "machine", "starts", "rows", "skipped"}
    assert [(row["points"], row["starts"]) for row in result["rows"]] == [(30, 5)] * 3 + [(40, 5), (40, 5), (40, 1)]
    for row in result["rows"]:
        assert row["fit_ms"] > 0
        assert row["rmse"] < 0.02
        assert 0.7 < row["coverage"] <= 1
        assert (row["append_us"] is None) == (row["name"] == "scikit-learn")
    assert result["rows"][0]["fit_ratio"] == 1
    assert result["machine"]["numpy"] == np.__version__


def test_bad_input_is_refused(stepgap: Command) -> None:
    Path("there.json").write_text("keep me")
    refused(stepgap("gp", "--out", "there.json", verbs=speed_line), "there.json: exists already; choose another --out")
    assert Path("there.json").read_text() == "keep me"


def test_openturns_fits_the_same_data() -> None:
    found, _ = gaussian_processes.libraries(quick=False)
    (peer,) = (library for library in found if library.name == "OpenTURNS")
    generator = np.random.default_rng(1)
    points = generator.uniform(-1, 1, (30, 4))
    mean, std = peer.predict(peer.fit(points, bench_gp.smooth_function(points), 1), points)
    np.testing.assert_allclose(mean, bench_gp.smooth_function(points), atol=0.02)
    assert np.all(std >= 0)

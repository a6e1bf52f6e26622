"""`benchmarks.speed map`: it runs and reports its measurements; no test checks the times."""

import json
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from benchmarks import compare_maps
from benchmarks.peers import full_system
from benchmarks.speed import step_map as bench_map
from benchmarks.speed.__main__ import speed_line
from stepgap.robots.hopper import Gains, RobotParameters
from stepgap.robots.hopper.model.apex_map import ApexMap
from tests.cli.command_line import Command, refused
from tests.robots.hopper.model.reference_answers import CASES, stored_answers

TINY = bench_map.MapBenchSize(points=1, rounds=1, jacobians=0, solves=3, table=5, batch=20)

SECTIONS = ("Jacobian ", "root solve ", "batch ", "command table ")
KEYS = {"schema", "quick", "seed", "machine", "engines", "skipped", "jacobian", "root_solve", "batch", "table"}


@pytest.fixture
def tiny(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bench_map, "QUICK_MAP_BENCH", TINY)


@pytest.mark.usefixtures("tiny")
def test_the_quick_bench_writes_json_and_a_table(stepgap: Command) -> None:
    command_result = stepgap("map", "--quick", verbs=speed_line)
    assert command_result.code == 0, command_result.err
    assert command_result.out.endswith("\nbench_map.json\n")
    for line in ("StepGap ", "StepGap in a batch ", *SECTIONS):
        assert re.search(f"^{line}", command_result.out, re.MULTILINE), line
    result = json.loads(Path("bench_map.json").read_text())
    assert result.keys() == KEYS
    ours, batch = result["engines"]
    assert (ours["name"], batch["name"]) == ("StepGap", "StepGap in a batch")
    assert ours["largest_relative_error"] is None, "there is no other engine to compare it with"
    assert result["skipped"] == {}
    assert result["root_solve"]["solved_share"] == 1
    assert result["machine"]["numpy"] == np.__version__


@pytest.mark.usefixtures("tiny")
def test_the_comparison_measures_peers_and_errors(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.argv", ["compare_maps.py", "--quick", "--out", str(tmp_path / "maps.json")])
    compare_maps.main()
    out = capsys.readouterr().out
    for line in ("StepGap ", "SciPy DOP853, NumPy ", "heyoka ", *SECTIONS):
        assert re.search(f"^{line}", out, re.MULTILINE), line
    result = json.loads((tmp_path / "maps.json").read_text())
    assert result.keys() == KEYS
    ours, _, scipy = result["engines"]
    assert (ours["name"], scipy["name"]) == ("StepGap", "SciPy DOP853, NumPy")
    for engine in (ours, scipy):
        assert engine["largest_relative_error"] < 1e-6
        assert engine["median_us"] > 0
    assert ours["ratio"] == 1
    assert set(result["skipped"]) == {"SciPy DOP853, Numba", "heyoka", "numbalsoda", "MuJoCo"}
    assert result["root_solve"]["solved_share"] == 1
    assert result["machine"]["numpy"] == np.__version__


def test_bad_input_is_refused(stepgap: Command) -> None:
    Path("there.json").write_text("keep me")
    refused(stepgap("map", "--out", "there.json", verbs=speed_line), "there.json: exists already; choose another --out")
    refused(stepgap("map", "--gains.stifness", "3", verbs=speed_line), "did you mean stiffness?")
    refused(stepgap("maps", verbs=speed_line), "maps")
    assert Path("there.json").read_text() == "keep me"


def test_settings_with_which_nothing_hops_fail_in_one_line(stepgap: Command) -> None:
    command_result = stepgap("map", "--quick", "--gains.rest_length", "0.2", verbs=speed_line)
    assert (command_result.code, command_result.out) == (1, "")
    assert command_result.err.splitlines()[-1].startswith("stepgap: only 0 of 12 random steps succeed; choose settings")
    assert not list(Path().iterdir())


@pytest.fixture(scope="module")
def peer() -> Callable:
    return full_system.make_hop(RobotParameters(), Gains(), full_system.plain, 1e-9, 1e-10)


def test_the_peer_is_the_same_robot(peer: Callable) -> None:
    case = CASES["range of use"]
    for point, answer in list(zip(case.points, stored_answers("range of use"), strict=True))[:4]:
        assert answer.status == 0
        np.testing.assert_allclose(peer(point[:2], point[2:]), answer.next_state, rtol=1e-7)


def test_extrapolated_differences_are_derivatives() -> None:
    nominal = ApexMap()

    def polynomial(state: np.ndarray, command: np.ndarray) -> np.ndarray:
        return np.array([state[0] ** 3 * command[1], state[1] * command[0]])

    state, command = np.array([0.2, 0.5]), np.array([3.0, 7.0])
    exact = [[3 * 0.04 * 7, 0, 0, 0.008], [0, 3.0, 0.5, 0]]
    np.testing.assert_allclose(bench_map.richardson(nominal, polynomial, state, command), exact, atol=1e-12)

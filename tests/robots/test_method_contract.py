"""Every method runs, and every robot has methods: a run is read, resumed, reported, compared and exported as another.

Methods know robots by their maps alone, so one robot has all of them, and each other robot one.
"""

import json
from dataclasses import replace
from itertools import cycle
from pathlib import Path

import numpy as np
import pytest

from stepgap.experiment.run import load_run
from stepgap.experiment.settings import METHODS
from stepgap.robots.entry_points import load_robot
from stepgap.robots.nominal_maps.affine_map import AffineMap
from tests.cli.command_line import Command
from tests.quick_runs import compute_in_a_thread, leave_out_sweep_report
from tests.robots.test_robot_contract import ROBOTS, SHORT, write_targets

NAMES = tuple(name for name in METHODS if name != "default")
OTHERS = [name for name in ROBOTS if name != "ball"]
PAIRS = [*(("ball", method) for method in NAMES), *zip(OTHERS, cycle(NAMES), strict=False)]


@pytest.mark.parametrize(("name", "method"), PAIRS)
@pytest.mark.usefixtures("no_repeats", "no_report", "package")
def test_a_run_of_every_method_learns_resumes_and_is_read(name: str, method: str, stepgap: Command) -> None:
    robot, folder = load_robot(name), Path("out")
    write_targets(robot, Path("targets.csv"), repeats=2)
    options = ("--robot", name, "--reference", "targets.csv", "--out", folder, *SHORT)
    assert stepgap("run", *options, "--method", method).code == 0
    run = load_run(folder)
    settings = run.needed(run.settings)
    learning, control, linear = METHODS[method]
    assert (settings.control, settings.nominal.linear) == (control, linear)
    assert settings.learning == replace(learning, iterations=1, early_stop=False)
    assert isinstance(run.nominal, AffineMap) or not linear
    assert [len(run.steps.of_iteration(iteration)) for iteration in (0, 1)] == [8, 8]
    assert run.residual_name(1) == learning.residual
    for iteration in (0, 1):
        steps = run.steps.of_iteration(iteration)
        plan = run.controller(iteration).plan(steps.state[0], steps.target[0], steps.target[1:])
        np.testing.assert_array_equal(plan.command, steps.requested[0])
    if robot.control():  # its simulation takes long
        return
    whole = (folder / "steps.csv").read_bytes()
    (folder / "steps.csv").write_bytes(whole[: whole.rindex(b"\n1,3,") + 1])
    (folder / "summary.json").unlink()
    assert stepgap("run", "--resume", "--out", folder, "--quiet").code == 0
    assert (folder / "steps.csv").read_bytes() == whole


@pytest.mark.usefixtures("no_repeats", "package")
def test_methods_are_swept_reported_compared_and_exported(stepgap: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    compute_in_a_thread(monkeypatch)
    leave_out_sweep_report(monkeypatch)
    write_targets(load_robot("ball"), Path("targets.csv"))
    Path("e.toml").write_text("robot = 'ball'\nreference = 'targets.csv'\n[learning]\niterations = 1\n")
    Path("sweep.toml").write_text(f"base = 'e.toml'\nseeds = [1]\n[axes]\n'method' = {json.dumps([*METHODS])}\n")
    assert stepgap("sweep", "sweep.toml", "--out", "sweep", "--quiet").code == 0
    runs = [Path("sweep", "runs", f"{case:08}") for case in range(len(METHODS))]
    for method, folder in zip(METHODS, runs, strict=True):
        settings = load_run(folder).needed(load_run(folder).settings)
        assert (settings.control, settings.nominal.linear) == METHODS[method][1:]
    assert stepgap("compare", *runs, "--out", "compared.html").code == 0
    assert "nominal.linear" in Path("compared.html").read_text()
    linear = runs[[*METHODS].index("rls")]
    for verb in (
        ["report", linear],
        ["export", linear, "--to", "csv"],
        ["fit", linear],
        ["gait", linear / "experiment.toml"],
    ):
        assert stepgap(*verb).code == 0
    assert stepgap("export", runs[[*METHODS].index("affine")], "--to", "c").code == 0
    assert "linear" in (linear / "report.html").read_text()

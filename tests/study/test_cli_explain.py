"""`stepgap explain`: a run of a weak hopper, explained by real simulations."""

import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from stepgap.cli.app import main
from stepgap.study import simulated_errors
from tests.cli.command_line import Command, refused
from tests.quick_runs import leave_out_repeats, leave_out_report

pytestmark = pytest.mark.usefixtures("no_repeats", "no_report")


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a run of 30 hops with weak motors."""
    folder = tmp_path_factory.mktemp("weak")
    targets = np.random.default_rng(0).uniform([0.0, 0.54], [0.4, 0.62], (30, 2))
    (folder / "targets.csv").write_text("speed,height\n" + "".join(f"{a:.3f},{b:.3f}\n" for a, b in targets))
    gap = ["--gap.preset", "none", "--gap.torque_scale", "0.9"]
    options = ["--reference", str(folder / "targets.csv"), *gap, "--iterations", "0", "--quiet"]
    with pytest.MonkeyPatch.context() as patch:
        leave_out_repeats(patch)
        leave_out_report(patch)
        main(["run", *options, "--out", str(folder / "weak")])
    return folder / "weak"


@pytest.fixture
def weak(run: Path, tmp_path: Path) -> Path:
    return shutil.copytree(run, tmp_path / "weak")


def test_a_weak_motor_is_found(weak: Path, stepgap: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(simulated_errors, "STEPS_PER_MONOMIAL", 4)
    known = ["--known", "motor_counts=200000, torque_noise=0.01"]
    found = stepgap("explain", weak, *known, "--causes", "torque_scale, boom_drag", "--out", "page.html", "--quiet")
    assert found.code == 0, found.err
    _, alone, acting, *_, path = found.out.splitlines()
    size = re.fullmatch(r"of single causes, torque_scale (\S+) explains most: (9\d|100) % of the squared diff.*", alone)
    assert size
    assert float(size[1]) == pytest.approx(0.9, abs=0.03)  # 0.90 or 0.93, by targets and by rounding of the machine
    assert acting.startswith("whatever the other causes do, these act: torque_scale 0.")
    assert path == "page.html"
    page = Path("page.html").read_text()
    assert "<svg" in page
    assert "Torque delivered per torque applied" in page


def test_wrong_input_is_refused(weak: Path, stepgap: Command) -> None:
    refused(stepgap("explain", weak, "--causes", "weight"), "--causes weight", "body_mass_scale")
    refused(stepgap("explain", weak, "--known", "weight=1"), "--known weight=1", "body_mass_scale")
    refused(stepgap("explain", weak, "--known", "torque_scale"), "--known torque_scale", "NAME=VALUE")
    refused(stepgap("explain", weak, "--known", "torque_scale=-1"), "--known torque_scale=-1", "torque_scale")
    together = "boom_arc=1,ground_friction=0.4,torque_scale=-1"  # boom_arc alone would be refused
    refused(stepgap("explain", weak, "--known", together), f"--known {together}", "torque_scale")
    refused(stepgap("explain", weak, "--known", "boom_drag=0.1", "--causes", "boom_drag"), "--causes boom_drag")
    refused(stepgap("explain", weak, "--out", "page.txt"), "page.txt", ".html")
    (weak / "steps.csv").write_text("".join((weak / "steps.csv").read_text().splitlines(keepends=True)[:9]))
    (weak / "summary.json").unlink()
    refused(stepgap("explain", weak), "8 completed steps", "30 are needed")

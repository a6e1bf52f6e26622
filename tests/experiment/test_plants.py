"""Plants of `stepgap run --plant`, from the command line to the summary."""

import csv
import json
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path
from time import sleep

import numpy as np
import pytest

from stepgap.base.errors import InputError
from stepgap.cli.app import main
from stepgap.control.reference import Reference
from stepgap.experiment import plants as run_plants
from stepgap.experiment.inputs import write_experiment
from stepgap.experiment.settings import Experiment, read_experiment
from stepgap.hardware.commissioning.check import Check, Timing, write_check
from stepgap.hardware.commissioning.proof import fingerprint, write_proof
from stepgap.hardware.ethercat.emulator.network import NoNetwork, wire
from tests.quick_runs import leave_out_report, repeat_less

EXAMPLE = Path(__file__).parents[2] / "examples" / "rig.toml"
REFERENCE = Reference(("speed", "height"), np.array([[0.1, 0.56]]))
MISSING_LIMITS = (
    "torque_step",
    "lean_angle",
    "fold_angle",
    "shortest_leg",
    "longest_leg",
    "lowest_hip",
    "highest_hip",
    "continuous_torque",
    "mean_power",
    "posture_torque",
    "posture_speed",
    "first_hops",
    "brake_torque",
    "jump_angle",
    "frozen_time",
    "ground_height",
    "motion_torque",
)
"""Limits that may be left out where there is no torque."""
TARGETS = "speed,height\n0.1,0.56\n0.2,0.58\n0.2,0.58\n"


@pytest.fixture(scope="module")
def raw_ethernet() -> None:
    """Skips a test where no ring can run."""
    pytest.importorskip("pysoem", reason="pysoem is locked for Linux only")
    try:
        with wire(f"sgp{os.getpid() % 10**6}"):
            pass
    except NoNetwork as reason:
        pytest.skip(str(reason))


def run(folder: Path, *arguments: str) -> Path:
    """Runs three steps into a new folder, and returns it."""
    (folder / "targets.csv").write_text(TARGETS)
    out = folder / "_".join(("run", *arguments))
    main(
        [
            "run",
            "--reference",
            str(folder / "targets.csv"),
            "--out",
            str(out),
            "--iterations",
            "0",
            "--quiet",
            *arguments,
        ]
    )
    return out


@pytest.fixture(scope="module")
def ring_run(raw_ethernet: None, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a run through the ring."""
    with pytest.MonkeyPatch.context() as patch:
        leave_out_report(patch)
        repeat_less(patch)
        return run(tmp_path_factory.mktemp("ring"), "--plant", "emulated-ring")


@pytest.mark.usefixtures("no_report")
def test_through_the_ring_a_run_has_the_figures_of_the_twin(
    tmp_path: Path, ring_run: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    repeat_less(monkeypatch)
    direct, ring = (json.loads((folder / "summary.json").read_text()) for folder in (run(tmp_path), ring_run))
    for summary in (direct, ring):
        assert summary["iterations"][0]["falls"] == 0
        assert summary["repeatability_measured"] is True
    for name, tolerance in (("speed", 0.02), ("height", 0.004)):
        biases = [summary["iterations"][0]["bias"][name] for summary in (direct, ring)]
        assert biases[0] == pytest.approx(biases[1], abs=tolerance), "quantisation has a small effect"


@pytest.mark.usefixtures("no_report", "no_repeats")
def test_a_run_through_the_ring_is_resumed_to_the_same_bytes(tmp_path: Path, ring_run: Path) -> None:
    folder = Path(shutil.copytree(ring_run, tmp_path / "run"))
    whole = (folder / "steps.csv").read_bytes()
    (folder / "steps.csv").write_bytes(whole[: whole.rindex(b"0,3,")])
    (folder / "summary.json").unlink()
    main(["run", "--resume", "--out", str(folder), "--quiet"])
    assert (folder / "steps.csv").read_bytes() == whole


def test_a_rig_has_torque_only_when_it_is_armed() -> None:
    settings = Experiment(plant="ethercat", rig=str(EXAMPLE))
    with pytest.raises(InputError, match="only with --arm"):
        run_plants.choose_plants(run_plants.PlantRequest(settings, REFERENCE, Path()))


def test_the_plant_and_its_rig_are_settings_of_a_run(tmp_path: Path) -> None:
    write_experiment(tmp_path, Experiment(plant="ethercat", rig=str(EXAMPLE)), REFERENCE)
    again = read_experiment(tmp_path / "experiment.toml")
    assert (again.plant, Path(again.rig)) == ("ethercat", EXAMPLE.resolve())
    (tmp_path / "mine.toml").write_text('plant = "ethercat"\nrig = "my_rig.toml"\n')
    assert read_experiment(tmp_path / "mine.toml").rig == str(tmp_path / "my_rig.toml")


@pytest.mark.parametrize("key", [*MISSING_LIMITS, "lean_angle, torque_step"])
def test_without_all_limits_there_is_no_torque(tmp_path: Path, key: str) -> None:
    """Each of the limits that may be left out for a simulation, and two together."""
    rig, names = tmp_path / "rig.toml", [part.partition(" ")[0] for part in key.split(", ")]
    lines = EXAMPLE.read_text("utf-8").splitlines()
    rig.write_text("\n".join(line for line in lines if line.partition(" ")[0] not in names), "utf-8")
    settings = Experiment(plant="ethercat", rig=str(rig))
    with pytest.raises(InputError) as refusal:
        run_plants.choose_plants(run_plants.PlantRequest(settings, REFERENCE, tmp_path, arm=True))
    order = [name for name in MISSING_LIMITS if name in names]
    assert f"{rig}: [limits] lacks {', '.join(order)}; torque needs" in str(refusal.value)


def test_settings_that_change_during_a_run_give_no_torque(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rig = tmp_path / "rig.toml"
    rig.write_bytes(EXAMPLE.read_bytes())
    timing = Timing(6000, 0.0, 0.0, 0.0, 0.0, 1.0, 0, 0)
    write_check(rig, fingerprint(rig), Check(1e-3, 2, False, timing, 0, "", ""))
    settings = Experiment(plant="ethercat", rig=str(rig))
    request = run_plants.PlantRequest(settings, REFERENCE, tmp_path, arm=True)
    with pytest.raises(InputError, match=r"rig\.jog\.json: there is no result of a jog"):
        run_plants.choose_plants(request)
    write_proof(rig, "jog", fingerprint(rig), {"passed": True})
    plants = run_plants.choose_plants(request)
    plants.make(np.random.default_rng(0))
    rig.write_text(rig.read_text("utf-8").replace("torque = 38.0", "torque = 39.0"), "utf-8")
    with pytest.raises(InputError, match="the settings have changed since"):
        plants.make(np.random.default_rng(0))


def test_sigterm_ends_a_run_as_ctrl_c_does(tmp_path: Path) -> None:
    command = [sys.executable, "-c", "from stepgap.cli.app import main; main()", "run", "--out", "run"]
    process = subprocess.Popen(command, cwd=tmp_path, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True)
    steps = tmp_path / "run" / "steps.csv"
    while process.poll() is None and not (steps.exists() and steps.read_bytes().count(b"\n") > 3):
        sleep(0.01)
    process.send_signal(signal.SIGTERM)
    _, error_output = process.communicate()
    assert process.returncode == 130
    assert "resume with: stepgap run --out run --resume" in error_output
    with steps.open(newline="") as file:
        rows = list(csv.reader(file))
    assert {len(row) for row in rows} == {len(rows[0])}, "no row is cut off"

"""`stepgap rig` on an emulated ring, with all its processes; nothing here depends on the speed of the machine."""

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import tomli_w

from stepgap.base.errors import InputError
from stepgap.base.settings_file import to_table
from stepgap.hardware.commissioning.check import checked
from stepgap.hardware.ethercat.emulator.emulator import emulated
from stepgap.hardware.ethercat.emulator.network import NoNetwork
from stepgap.hardware.ethercat.emulator.ring_settings import RingSettings
from stepgap.hardware.hopper.ethercat import RigSettings, read_rig_settings
from stepgap.hardware.hopper.ring_rig import emulated_settings
from stepgap.plants.ticks.rig_state import RigState
from stepgap.plants.ticks.tick_log import read_ticks
from stepgap.robots.hopper.parameters import RobotParameters
from stepgap.robots.hopper.tick.sensors import HopperSensorModel
from tests.cli.command_line import Command, CommandResult, refused
from tests.hardware.hopper.jigged_machine import POSE, JiggedMachine

pytest.importorskip("pysoem", reason="pysoem is locked for Linux only")
pytestmark = pytest.mark.usefixtures("warm_realtime")

INTERFACE = f"sg{os.getpid() % 10**7}"
TICK = 0.01
"""A period so long that a busy machine seldom misses the 50 ticks in a row that stop a rig."""
LAYOUT = HopperSensorModel(
    tick=TICK,
    boom_length=RobotParameters().boom_length,
    pivot_height=0.4,
    motor_counts=16384,
    boom_counts_horizontal=5000,
    boom_counts_vertical=16384,
    touchdown_force=5.0,
    takeoff_length=0.273,
)


@pytest.fixture(scope="module")
def ring() -> Iterator[RigSettings]:
    """A ring in lock-step, and its rig.toml."""
    settings = RingSettings()
    running = emulated(INTERFACE, partial(JiggedMachine, TICK), settings)
    try:
        running.__enter__()
    except NoNetwork as refusal:
        pytest.skip(str(refusal))
    yield emulated_settings(LAYOUT, RobotParameters(), settings, INTERFACE)
    running.__exit__(None, None, None)


@pytest.fixture
def rig_file(ring: RigSettings, tmp_path: Path) -> Path:
    path = tmp_path / "rig.toml"
    path.write_text(f"# mine\n{tomli_w.dumps(to_table(ring))}", encoding="utf-8")
    return path


def unless_too_late(result: CommandResult) -> CommandResult:
    """Skips the test if this machine was so late that a robot had to be stopped."""
    if result.code == 1 and "stopped the robot: late" in result.err:
        pytest.skip("this machine is too busy for 100 ticks a second")
    return result


def test_table_exit_code_and_file_of_a_check_agree(stepgap: Command, rig_file: Path) -> None:
    result = stepgap("rig", "check", "rig.toml", "--seconds", 0.3)
    found = json.loads(Path("rig.check.json").read_text("utf-8"))
    assert result.out.endswith("\nrig.check.json\n")
    assert result.code == (0 if found["passed"] else 1)
    assert ("not passed" in result.out) == (not found["passed"])
    assert found["late_ticks"] == 40
    timing = found["timing"]
    assert timing["ticks"] == 30 or found["fault"]
    assert f"ticks                 {timing['ticks']}, one every 10000 µs\n" in result.out
    assert f"at most     {1e6 * timing['worst']:.1f} µs\n" in result.out
    assert f"frames lost           {found['lost_frames']}\n" in result.out
    with pytest.raises(InputError, match=r"measured 0\.3 s, less than 5" if found["passed"] else "not passed"):
        checked(rig_file)


def test_without_a_bus_the_machine_is_measured_and_nothing_written(stepgap: Command) -> None:
    result = stepgap("rig", "check", "--seconds", 0.3)
    assert result.code == ("not passed" in result.out)
    assert result.out.startswith("no rig.toml given: timing of this machine alone")
    assert "frames lost           no bus was measured\n" in result.out
    assert not list(Path.cwd().iterdir())


def test_a_dry_run_displays_and_logs_the_torques_of_the_control_law(stepgap: Command, rig_file: Path) -> None:
    result = unless_too_late(stepgap("rig", "dry-run", rig_file, "--seconds", 1.5))
    assert (result.code, result.out) == (0, "dry-run/ticks-0.mcap\n"), result
    units, ticks = read_ticks(Path("dry-run/ticks-0.mcap"))
    column = dict(zip(units, ticks.T, strict=True))
    assert len(ticks) >= 50
    assert RigState.READY in column["state"]
    assert set(column["state"]) <= {RigState.CALIBRATE, RigState.READY, RigState.OFF}
    assert not np.any([column["applied_1"], column["applied_2"]])
    assert column["asked_1"].any()
    shown = result.err.splitlines()[-1]
    angle = 360 / 16384 * (2100 - 2050) / 2
    assert f"alpha_1 {angle:+.2f}°" in shown
    assert "contact +1.0 N" in shown
    explained = stepgap("rig", "incident", "dry-run/ticks-0.mcap")
    assert (explained.code, explained.err) == (0, "")
    assert explained.out.startswith(f"dry-run/ticks-0.mcap: {len(ticks)} ticks, ")
    assert explained.out.endswith("\ndry-run/ticks-0_incident.png\n")
    assert Path("dry-run/ticks-0_incident.png").read_bytes().startswith(b"\x89PNG")


def test_calibration_corrects_the_pose_and_keeps_comments(stepgap: Command, rig_file: Path, ring: RigSettings) -> None:
    options = ["--leg-length", 0.26, "--height", 0.6, "--alpha-1", 0.05]
    result = unless_too_late(stepgap("rig", "calibrate", rig_file, *options))
    assert result.code == 0, result
    out = Path(result.out.splitlines()[-1])
    assert out == rig_file.with_name("rig.calibrated.toml")
    assert out.read_text("utf-8").startswith("# mine\n")
    after = read_rig_settings(out)
    count = 2 * np.pi / 16384
    phi_1, phi_2 = (count * (POSE[motor] - getattr(after, f"motor_{motor + 1}").zero) for motor in (0, 1))
    assert (phi_1 + phi_2) / 2 == pytest.approx(0.05, abs=count)
    assert (after.boom_horizontal.zero, after.contact.zero) == (77, 10)
    height = 0.4 + LAYOUT.boom_length * np.sin(count * (330 - after.boom_vertical.zero))
    assert height == pytest.approx(0.6, abs=LAYOUT.boom_length * count)
    for table in ("motor_1", "motor_2", "boom_vertical"):
        assert f"{table:16} {0:>12} {getattr(after, table).zero:>12}" in result.out
    zeros = {
        name: getattr(after, name) for name in ("motor_1", "motor_2", "boom_vertical", "boom_horizontal", "contact")
    }
    assert replace(ring, **zeros) == after
    refused(stepgap("rig", "calibrate", rig_file, *options), "exists already; choose another --out")


def test_a_missing_bus_is_reported_in_one_line(stepgap: Command, rig_file: Path) -> None:
    rig_file.write_text(rig_file.read_text("utf-8").replace(INTERFACE, "nowhere"), encoding="utf-8")
    result = stepgap("rig", "check", rig_file, "--seconds", 0.2)
    assert (result.code, result.out) == (1, "")
    assert result.err.startswith("stepgap: interface nowhere cannot be opened")
    assert result.err.count("\n") == 1
    assert not Path("rig.check.json").exists()


WRONG = [
    (["check", "none.toml"], "none.toml: No such file or directory"),
    (["check", "broken.toml"], "broken.toml: not TOML"),
    (["check", "--plant", "ethercat"], "--plant ethercat: valid only with RIG_FILE"),
    (["check", "--seconds", "nan"], "--seconds nan: it must lie between"),
    (["check", "--seconds", "0"], "--seconds 0: it must lie between"),
    (["check", "--gap.delay", "0"], "--gap.delay: this command takes no settings"),
    (["check", "--", "true"], "-- true: this command runs no other program"),
    (["dry-run"], "requires an argument"),
    (["dry-run", "none.toml"], "none.toml: No such file or directory"),
    (["dry-run", "none.toml", "--seconds", "-1"], "--seconds -1"),
    (["calibrate", "none.toml"], "--leg-length and --height: give both"),
    (["calibrate", "none.toml", "--leg-length", "0.26", "--height", "inf"], "--height inf: it must be finite"),
    (["calibrate", "none.toml", "--leg-length", "0.26", "--height", "0.5", "--alpha-1", "5"], "in radians"),
    (["calibrate", "none.toml", "--leg-length", "0.26", "--height", "0.5"], "none.toml: No such file or directory"),
    (["emulate", "--gap.preset", "none"], "[gap] motor_counts = inf: a ring carries integer counts"),
    (["emulate", "stepgap", "rig", "check", "e.toml"], "type `stepgap rig emulate -- stepgap rig check e.toml`"),
    (["emulate", "stepgap", "rig", "check", "e.toml", "--seconds", "5"], "-- stepgap rig check e.toml --seconds 5`"),
    (["emulate", "mine.toml", "sh", "-c", "a b"], "type `stepgap rig emulate mine.toml -- sh -c 'a b'`"),
    (["emulate", "mine.toml", "--intreface", "x"], "--intreface: not an option of rig emulate"),
    (["emulate", "--hold", "inf"], "--hold inf: it must lie between"),
    (["emulate", "--parameters.boom_length", "0.05"], "no twin can be made"),
    (["emulate", "--settings", "broken.toml"], "broken.toml: exists and describes another rig"),
    (["emulate", "--settings", "none/e.toml"], "cannot be written"),
]


@pytest.mark.parametrize(("arguments", "expected"), WRONG, ids=[" ".join(arguments) for arguments, _ in WRONG])
def test_wrong_input_is_one_line(stepgap: Command, arguments: list[str], expected: str) -> None:
    Path("broken.toml").write_text("[")
    command = ["--", "true"] if arguments[0] == "emulate" else []  # a ring that should not be ends nevertheless
    refused(stepgap("rig", *arguments, *command), expected)
    assert Path("broken.toml").read_text() == "["
    assert len(list(Path.cwd().iterdir())) == 1


MAIN = "from stepgap.cli.app import main; main()"
emulate = partial(lambda code, *arguments: [sys.executable, "-c", code, "rig", "emulate", *arguments], MAIN)


def seen(text: str) -> None:
    if "needs root" in text or "not permitted" in text or "only root" in text:
        pytest.skip(text)


def test_a_command_runs_with_the_ring_and_its_exit_code_is_returned(stepgap: Command, tmp_path: Path) -> None:
    code = f"import socket, sys; socket.if_nametoindex('{INTERFACE}t'); print(sys.argv[1:]); sys.exit(7)"
    arguments = ["--interface", f"{INTERFACE}t", "--gap.boom_pivot_height", "0.41", "--lock-step"]
    result = stepgap("rig", "emulate", *arguments, "--", sys.executable, "-c", code, "--gap.delay", "0")
    seen(result.err)
    assert (result.code, result.err) == (7, "")
    assert result.out == "emulated.toml\n['--gap.delay', '0']\n"
    settings = read_rig_settings(tmp_path / "emulated.toml")
    layout = replace(LAYOUT, tick=1e-3, pivot_height=0.41)
    assert settings == emulated_settings(layout, RobotParameters(), RingSettings(), f"{INTERFACE}t")


def test_it_ends_at_ctrl_c(tmp_path: Path) -> None:
    command = emulate("--interface", f"{INTERFACE}c")
    with subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout
        assert process.stderr
        lines = [process.stdout.readline(), process.stdout.readline()]
        process.send_signal(signal.SIGINT)
        error = process.stderr.read()
        seen(error)
        assert process.wait(600) == 0, error
        assert lines[1].startswith(f"EtherCAT ring on {INTERFACE}c: drive_1, drive_2, coupler")


def test_sigterm_ends_the_command_of_the_ring_too(tmp_path: Path) -> None:
    code = "import os, time; print(os.getpid(), flush=True); time.sleep(1000)"
    command = emulate("--interface", f"{INTERFACE}s", "--", sys.executable, "-c", code)
    with subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout
        assert process.stderr
        process.stdout.readline()
        beside = process.stdout.readline()
        process.send_signal(signal.SIGTERM)
        error = process.stderr.read()
        seen(error)
        assert process.wait(600) == 128 + signal.SIGTERM, error
    with pytest.raises(ProcessLookupError):
        os.kill(int(beside), 0)


def test_sigterm_ends_a_dry_run_as_ctrl_c_does_with_a_complete_log(rig_file: Path) -> None:
    command = [sys.executable, "-c", MAIN, "rig", "dry-run", str(rig_file)]
    with subprocess.Popen(
        command, cwd=rig_file.parent, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as dry:
        assert dry.stderr
        while "READY" not in (line := dry.stderr.readline()):
            if "stopped the robot: late" in line:
                pytest.skip("this machine is too busy for 100 ticks a second")
            assert line, "it ended"
        dry.send_signal(signal.SIGTERM)
        assert dry.wait(600) == 0
    assert len(read_ticks(rig_file.parent / "dry-run/ticks-0.mcap")[1]) > 20


OTHER_USER = """
import os
if os.environ.get("INSIDE") is None:
    os.environ["INSIDE"] = "1"
    os.geteuid = lambda: 1000
from stepgap.cli.app import main
main()
"""


def test_without_root_the_command_runs_in_a_separate_network(
    stepgap: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    arguments = ["rig", "emulate", "--interface", f"{INTERFACE}u"]
    with monkeypatch.context() as other_user:
        other_user.setattr(os, "geteuid", lambda: 1000)
        other_user.setattr(sys, "argv", ["stepgap", *arguments])
        alone = stepgap(*arguments)
    assert (alone.code, alone.out) == (1, "")
    assert alone.err.startswith("stepgap: only root can make a network interface")
    assert f"rig emulate --interface {INTERFACE}u -- stepgap rig check emulated.toml`" in alone.err
    outside = {name: value for name, value in os.environ.items() if name != "INSIDE"}
    code = "import socket, sys; print([name for _, name in socket.if_nameindex()]); sys.exit(5)"
    command = [sys.executable, "-c", OTHER_USER, *arguments, "--", sys.executable, "-c", code]
    result = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=600, env=outside)
    if "unshare" in result.stderr:
        pytest.skip(result.stderr)
    assert (result.returncode, result.stderr) == (5, "")
    names = result.stdout
    assert f"{INTERFACE}u" in names
    assert "eth" not in names, "it sees no interface of the machine"

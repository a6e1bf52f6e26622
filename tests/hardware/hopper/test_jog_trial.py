"""The procedure of `stepgap rig jog` on an emulated ring, with its real-time process and a person at a terminal."""

import os
import sys
from functools import partial
from io import StringIO
from pathlib import Path

import numpy as np
import pytest

from stepgap.hardware.hopper import jog_trial
from stepgap.hardware.hopper.ethercat import hopper_on_ethercat
from stepgap.hardware.hopper.jog_trial import try_motors
from stepgap.hardware.hopper.twin_machine import TwinMachine
from stepgap.hardware.realtime import consent
from stepgap.hardware.realtime.process import RealtimeSetup
from stepgap.plants.ticks.tick_log import read_description
from stepgap.rigs.rig import RigFault
from stepgap.robots.hopper.tick.hop_control import HopperControl
from stepgap.robots.hopper.twin.reality_gap import RealityGap
from stepgap.robots.hopper.twin.twin import Twin
from tests.hardware.ethercat.ring_process import RecordedTwin, live_ring
from tests.hardware.realtime.patience import patient
from tests.hardware.realtime.test_faults import BOUNDS, EMULATED_LIMITS, GAINS, ROBOT, SETTINGS, replace

pytest.importorskip("pysoem", reason="pysoem is locked for Linux only")
pytestmark = pytest.mark.usefixtures("warm_realtime")

CONTROL = HopperControl(ROBOT, GAINS, BOUNDS)
SETTINGS_OF_JOG = replace(SETTINGS, limits=EMULATED_LIMITS)
MAKE_RIG = partial(hopper_on_ethercat, SETTINGS_OF_JOG, ROBOT)


class Hanging(RecordedTwin):
    """The twin hangs for good; friction holds its limp leg."""

    def __init__(self) -> None:
        TwinMachine.__init__(self, Twin(ROBOT, RealityGap(joint_friction=0.1), np.random.default_rng(3), hold=1e4))
        self.torques: list[tuple[float, float]] = []


class Inverted(Hanging):
    """Motor 1 is wired the wrong way round."""

    def tick(self, torques):
        torque_1, torque_2 = torques
        return super().tick((-torque_1, torque_2))


class Person(StringIO):
    """Presses Enter whenever the screen asks for it, up to a number of times; then the terminal is closed."""

    def __init__(self, terminal: int, answers: int):
        super().__init__()
        self._terminal, self._answers = terminal, answers

    def write(self, text: str) -> int:
        if "ress Enter" in text:
            os.write(self._terminal, b"\n" if self._answers else b"\x04")
            self._answers -= 1
        return super().write(text)


def tried(monkeypatch: pytest.MonkeyPatch, make_machine, simulated: bool = True, answers: int = 100):
    ours, theirs = os.openpty()
    try:
        with os.fdopen(theirs) as terminal, live_ring(make_machine=make_machine) as ring:
            # In lock-step with the ring, no tick is late on a busy machine.
            monkeypatch.setattr(jog_trial, "RealtimeSetup", partial(RealtimeSetup, make_pace=patient))
            monkeypatch.setattr(sys, "stdin", terminal)
            monkeypatch.setattr(sys, "stderr", Person(ours, answers))
            found = try_motors(MAKE_RIG, CONTROL, simulated, "as in rig.toml")
            return found, np.array(ring.look().torques)
    finally:
        os.close(ours)


@pytest.fixture(autouse=True)
def _folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def test_both_motors_pass_one_after_the_other(monkeypatch, capsys) -> None:
    found, torques = tried(monkeypatch, Hanging)
    assert (found["passed"], found["failures"]) == (True, [])
    first, second = found["motors"]
    assert (first["motor"], second["motor"]) == (1, 2)
    assert 0 < np.abs(torques).max() <= 1.0
    assert not (torques.all(axis=1)).any(), "never both motors at once"
    assert read_description(Path(first["log"]))[0].settings == "as in rig.toml"
    assert "motor 2  passed  (jog/ticks-1.mcap)" in capsys.readouterr().out


def test_the_first_motor_that_fails_ends_the_trial(monkeypatch, capsys) -> None:
    found, torques = tried(monkeypatch, Inverted)
    assert not found["passed"]
    assert [motor["motor"] for motor in found["motors"]] == [1]
    assert found["failures"][0].startswith("motor 1: its link moves against the torque")
    assert np.abs(torques).max() <= 1.0
    assert not torques[:, 1].any(), "motor 2 is not tried"
    assert "motor 1  not passed: motor 1: its link moves against" in capsys.readouterr().out


def test_a_link_that_nobody_turns_gets_no_torque(monkeypatch) -> None:
    found, torques = tried(monkeypatch, Hanging, simulated=False)
    assert not found["passed"]
    assert found["failures"][0].endswith("it is not connected, or stands still")
    assert not torques.any()


def test_a_closed_terminal_gives_no_torque(monkeypatch) -> None:
    with pytest.raises(RigFault, match="the terminal was closed"):
        tried(monkeypatch, Hanging, simulated=False, answers=1)


def test_without_the_held_key_there_is_no_torque(monkeypatch) -> None:
    """The links are turned as they should be; the person then presses no key and closes the terminal."""
    monkeypatch.setattr("stepgap.hardware.hopper.jog_trial._turn_by_hand", lambda *_: (0.785, 0.785))
    monkeypatch.setattr(consent, "_read", lambda _: b"")
    monkeypatch.setattr(consent.select, "select", lambda *_: ([0], [], []))
    found, torques = tried(monkeypatch, Hanging, simulated=False)
    assert found["failures"] == ["motor 1: the terminal was closed, so no torque was given"]
    assert not torques.any()

"""Sensors that fail while the robot hops, on an emulated ring with the twin: time to torque off, reason, torque."""

from dataclasses import replace

import numpy as np
import pytest

from stepgap.hardware.ethercat.emulator.faults import Fault
from stepgap.plants.ticks.rig_state import RigState
from stepgap.step import StepStatus
from tests.hardware.realtime import test_faults
from tests.hardware.realtime.test_faults import COLUMN, cycles_to_connect, deployment

pytest.importorskip("pysoem", reason="pysoem is locked for Linux only")

ASCENT, STANCE = 790, 640
"""Ticks in which the robot rises after its first take-off, and in which its leg is compressed."""
DEGREE = 16384 / 360
YAW_DEGREE = 5000 / 360

AT_ONCE = {
    "motor 1 jumps by 0.5°": (Fault("shifted", 0, "drive_1", counts=round(DEGREE / 2)), "motor 1 jumped"),
    "motor 2 jumps by 2°": (Fault("shifted", 0, "drive_2", counts=round(-2 * DEGREE)), "motor 2 jumped"),
    "motor 1 jumps by 5°": (Fault("shifted", 0, "drive_1", counts=round(5 * DEGREE)), "motor 1 jumped"),
    "motor 2 jumps by 90°": (Fault("shifted", 0, "drive_2", counts=round(90 * DEGREE)), "motor 2 jumped"),
    "yaw jumps by 0.5°": (Fault("shifted", 0, "boom_horizontal", counts=round(YAW_DEGREE / 2)), "yaw jumped"),
    "pitch jumps by 0.5°": (Fault("shifted", 0, "boom_vertical", counts=round(-DEGREE / 2)), "pitch jumped"),
    "motor 1 is noisy": (Fault("noisy", 0, "drive_1", deviation=5.0), "motor 1"),
    "pitch is noisy": (Fault("noisy", 0, "boom_vertical", deviation=5.0), "pitch"),
    "force is noisy": (Fault("noisy", 0, "contact_force", deviation=100.0), "contact in air"),
    "motor 1 freezes": (Fault("frozen", 0, "drive_1"), "motor 1 frozen"),
    "position 2 freezes, its velocity does not": (
        Fault("frozen", 0, "drive_2", with_velocity=False),
        "velocity (0x606C)",
    ),
    "a terminal reports invalid data": (
        Fault("reported error", 0, "boom_vertical"),
        "'boom_vertical': its status word",
    ),
    "the force is over its range": (
        Fault("reported error", 0, "contact_force", bits=0x0002),
        "'contact_force': its status word",
    ),
}
"""Faults just after take-off, and a part of the reason; torque must be off within 20 ms."""

WITHIN_A_HOP = {
    "pitch freezes": (Fault("frozen", 0, "boom_vertical"), ASCENT, "pitch frozen"),
    "pitch freezes in stance": (Fault("frozen", 0, "boom_vertical"), STANCE, "foot below ground"),
    "yaw freezes": (Fault("frozen", 0, "boom_horizontal"), ASCENT, "yaw against leg"),
    "force freezes at zero": (Fault("frozen", 0, "contact_force"), ASCENT, "the contact force is wrong"),
    "force freezes in stance": (Fault("frozen", 0, "contact_force"), STANCE, "contact"),
}
"""Faults that only the rest of a hop reveals, the tick in which they begin, and the reason."""

LONGEST_HOP = 1200
"""Ticks from one apex to the next; a hop of the test takes 0.7 s."""


@pytest.fixture(autouse=True)
def _limits(monkeypatch):
    """The limits of an emulated ring with a person beside it: those of rig.toml."""
    limits = replace(test_faults.EMULATED_LIMITS, torque=36.0, torque_step=20.0, joint_speed=80.0, lost_frames=2)
    monkeypatch.setattr(test_faults, "SETTINGS", replace(test_faults.SETTINGS, limits=limits))


def ticks_to_torque_off(tick, *faults):
    """Runs the robot until the faults, which begin in a tick, have stopped it; checks that torque is off for good.

    Returns:
        Number of ticks with torque from the first one that shows the fault, largest torque in them [N·m], message, and
        the hops that ended after the fault.
    """
    begun = [fault.at(cycles_to_connect() + tick) for fault in faults]
    with deployment(*begun) as (ring, hopping):
        assert hopping.run(tick - 1)
        before = len(hopping.hops)
        assert not hopping.run(3 * LONGEST_HOP), "nothing stopped the robot"
        assert hopping.loop.state == RigState.FAULT
        hops = [*hopping.hops[before:], hopping.board.finished(len(hopping.hops))]
        torques = np.array(hopping.rows)[tick - 1 :, COLUMN["applied_1"] : COLUMN["applied_2"] + 1]
        given = torques[np.isfinite(torques).all(axis=1) & torques.any(axis=1)]
        hopping.rig.close()
        assert ring.look().now == [0.0, 0.0]
        return len(given), np.abs(given).max(), hopping.board.message, hops


@pytest.mark.parametrize("name", AT_ONCE)
def test_torque_is_off_within_20_ms_after(name):
    fault, reason = AT_ONCE[name]
    ticks, torque, message, hops = ticks_to_torque_off(ASCENT, fault)
    assert ticks <= 20
    assert torque < 5.0, "neither the fault nor the stop gives a torque peak"
    assert reason in message
    assert [hop.status for hop in hops] == [StepStatus.DOUBTFUL]


def test_torque_is_off_within_20_ms_after_both_motor_encoders_freeze():
    ticks, torque, message, hops = ticks_to_torque_off(
        ASCENT, Fault("frozen", 0, "drive_1"), Fault("frozen", 0, "drive_2")
    )
    assert ticks <= 20
    assert torque < 5.0
    assert "frozen" in message
    assert [hop.status for hop in hops] == [StepStatus.DOUBTFUL]


@pytest.mark.parametrize("name", WITHIN_A_HOP)
def test_torque_is_off_within_a_hop_after(name):
    fault, tick, reason = WITHIN_A_HOP[name]
    ticks, torque, message, hops = ticks_to_torque_off(tick, fault)
    assert ticks <= LONGEST_HOP
    assert torque < 20.0, "no more than a hop needs"
    assert reason in message or "the contact force is wrong" in message
    # A frozen force sends torques of the other phase, which the motion of the leg may contradict first.
    assert hops[-1].status in (StepStatus.DOUBTFUL, StepStatus.STOPPED)
    assert len(hops) <= 2

"""A hopping twin whose drives become hot, whose bus voltage rises, or whose STO input opens, on the emulated ring."""

import numpy as np
import pytest

from stepgap.hardware.commissioning.limp import LastTick, describe_devices
from stepgap.hardware.ethercat.drive_watch import BEYOND, MOST_WARNED
from stepgap.hardware.ethercat.emulator.faults import Fault
from stepgap.hardware.incident import describe_incident
from stepgap.hardware.realtime.board import Request
from stepgap.plants.ticks.rig_state import RigState
from tests.hardware.realtime.test_faults import (
    COLUMN,
    HOPPING,
    Deployment,
    check_torques,
    cycles_to_connect,
    deployment,
    incident_of,
)

pytest.importorskip("pysoem", reason="pysoem is locked for Linux only")


def at(tick: int, fault: Fault) -> Fault:
    return fault.at(cycles_to_connect() + tick)


def column(hopping: Deployment, name: str) -> np.ndarray:
    return np.array([row[COLUMN[name]] for row in hopping.rows])


def test_the_first_thrust_is_within_the_limits():
    """Whole hops with these limits are in `test_faults`."""
    with deployment() as (ring, hopping):
        assert hopping.run(HOPPING + 300)
        assert hopping.board.message == ""
        check_torques(ring, hopping)
        temperature, voltage = column(hopping, "motor_1_temperature"), column(hopping, "motor_2_bus_voltage")
        assert temperature.tolist() == pytest.approx([25.0] * len(temperature), abs=0.2)
        assert 40.0 < voltage.min() < 48.0 <= voltage.max() < 55.0
        rig, last = hopping.rig, dict(zip(COLUMN, hopping.rows[-1], strict=True))
        shown = describe_devices(rig, last)
        assert shown["motor_1_sto"] == shown["motor_2_enable"] == "closed"
        assert shown["motor_1_temperature"] == f"{temperature[-1]:.1f} °C"
        assert set(shown) == {
            f"motor_{motor}_{name}" for motor in (1, 2) for name in ("temperature", "bus_voltage", "sto", "enable")
        }


STOPPED = {
    "STO": (
        Fault("opened input", 0, "drive_2"),
        1,
        "the STO input of slave 2 'drive_2' is open",
        "motor_2_sto: closed → open",
    ),
    "overvoltage": (
        Fault("fed bus", 0, "drive_1", power=50_000.0),
        10 + BEYOND,
        "slave 1 'drive_1': its bus voltage is 6",
        "motor_1_bus_voltage",
    ),
}


@pytest.mark.parametrize("name", STOPPED)
def test_torque_is_off_without_a_brake_and_the_log_explains_it(name, tmp_path):
    fault, most, expected, shown = STOPPED[name]
    with deployment(at(HOPPING, fault)) as (ring, hopping):
        assert not hopping.run(HOPPING + 1500)
        assert HOPPING <= len(hopping.rows) <= HOPPING + 1 + most
        assert hopping.loop.state == RigState.FAULT
        assert expected in hopping.board.message
        check_torques(ring, hopping)
        assert ring.look().now == [0.0, 0.0]
        last = LastTick(COLUMN)
        last.append(np.array(hopping.rows))
        assert last.fields["state"] == RigState.FAULT
        assert describe_devices(hopping.rig, last.fields)["motor_2_sto"] == ("open" if name == "STO" else "closed")
        explained = describe_incident(incident_of(hopping, tmp_path / "a.mcap"))
        for text in (expected, shown, "state: STEP → FAULT", "motor_2_temperature", "torque was off 0 ms after"):
            assert text in explained


def test_a_warm_drive_lands_the_robot():
    heated = (
        at(HOPPING, Fault("heated", 0, "drive_1", rate=1000.0)),
        at(HOPPING + 60, Fault("heated", 0, "drive_1", rate=-1000.0)),
    )
    with deployment(*heated) as (ring, hopping):
        assert not hopping.run(HOPPING + 3000)
        assert hopping.loop.state == RigState.OFF
        assert hopping.board.message.startswith("slave 1 'drive_1': its temperature is 8")
        assert hopping.board.message.endswith("more than 80: the robot lands")
        states = column(hopping, "state")
        assert HOPPING + 50 <= np.argmax(states == RigState.STOP) <= HOPPING + 62
        assert column(hopping, "motor_1_temperature").max() < 90.0
        check_torques(ring, hopping)


def test_a_drive_that_gets_hotter_while_the_robot_lands_gets_no_torque():
    with deployment(at(HOPPING, Fault("heated", 0, "drive_2", rate=100.0))) as (ring, hopping):
        assert not hopping.run(HOPPING + 3000)
        assert hopping.loop.state == RigState.FAULT
        states = column(hopping, "state")
        warned, stopped = np.argmax(states == RigState.STOP), np.argmax(states == RigState.FAULT)
        assert warned - HOPPING == pytest.approx(550, abs=20)
        assert stopped - warned == pytest.approx(100, abs=3)
        assert hopping.board.message.endswith("allowed is at most 90")
        assert ring.look().now == [0.0, 0.0]


def test_a_warm_drive_gets_no_torque_at_all():
    with deployment(Fault("heated", 0, "drive_1", rate=1000.0)) as (ring, hopping):
        hopping.board.request = Request.NOTHING
        while hopping.loop.tick():
            assert len(hopping.rows) < 200
        assert hopping.loop.state == RigState.FAULT
        assert hopping.board.message.endswith("more than 80: no torque is given")
        assert not any(map(any, ring.look().torques))
        assert ring.look().enabled == [True, True], "until the rig is closed"


DISOBEDIENT = {
    "runs away": (Fault("wrong torque", 0, "drive_2", offset=2000), 8, "slave 2 'drive_2': its torque is 20"),
    "runs away backward": (Fault("wrong torque", 0, "drive_1", offset=-2000), 8, "slave 1 'drive_1': its torque is -"),
    "turns the wrong way": (Fault("wrong torque", 0, "drive_1", factor=-1.0), 8, "slave 1 'drive_1': its torque is "),
    "is dead": (Fault("wrong torque", 0, "drive_2"), 20, "slave 2 'drive_2': its torque is 0, commanded were "),
    "keeps its torque": (Fault("wrong torque", 0, "drive_1", is_kept=True), 40, "only its STO input stops it"),
    "hangs": (Fault("stalled", 0, "drive_1", cycles=10**6), 20, "slave 1 'drive_1': "),
    "ignores its commands": (Fault("status bits", 0, "drive_1", cleared=0x1000), 4, "it ignores its commands (bit 12"),
}
"""Fault in the first thrust, most ticks until torque is off, and the message."""


@pytest.mark.parametrize("name", DISOBEDIENT)
def test_a_drive_that_does_not_follow_its_commands_is_found_by_its_torque(name):
    fault, most, expected = DISOBEDIENT[name]
    with deployment(at(HOPPING, fault)) as (ring, hopping):
        assert not hopping.run(HOPPING + 1500)
        assert HOPPING <= len(hopping.rows) <= HOPPING + 1 + most
        assert hopping.loop.state == RigState.FAULT
        assert expected in hopping.board.message
        hangs = fault.kind == "stalled"
        assert (ring.look().now[0] != 0.0) == hangs, "torque is off, but for a drive that hangs"
        assert ring.look().now[1] == 0.0
        assert max(abs(row[COLUMN["joint_speed"]]) for row in hopping.rows) < 40.0


@pytest.mark.parametrize("bits", [0x0080, 0x0800])
def test_the_robot_lands_when_a_drive_warns_or_is_at_an_internal_limit(bits):
    with deployment(at(HOPPING, Fault("status bits", 0, "drive_2", raised=bits))) as (_, hopping):
        assert not hopping.run(HOPPING + 4000)
        states = [int(row[COLUMN["state"]]) for row in hopping.rows]
        assert states.index(RigState.STOP) >= HOPPING + MOST_WARNED - 1
        assert hopping.loop.state == RigState.OFF
        assert "slave 2 'drive_2': it " in hopping.board.message

"""The ring over a veth pair, with SOEM (pysoem) as its master and the twin behind the drives."""

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from struct import Struct, pack
from typing import Any

import numpy as np
import pytest

from stepgap.hardware.ethercat.emulator.emulator import emulated
from stepgap.hardware.ethercat.emulator.faults import Fault
from stepgap.hardware.ethercat.emulator.network import NoNetwork, raw_socket, wire
from stepgap.hardware.ethercat.emulator.ring import Machine
from stepgap.hardware.ethercat.emulator.ring_settings import RingSettings
from stepgap.hardware.hopper.twin_machine import TwinMachine
from stepgap.robots.hopper.parameters import RobotParameters
from stepgap.robots.hopper.twin.reality_gap import RealityGap
from stepgap.robots.hopper.twin.twin import Twin
from tests.hardware.ethercat.emulator.bench import DRIVE_INPUT, DRIVES, ENCODER_INPUT, ENCODERS, LENGTHS, Flywheels
from tests.hardware.ethercat.emulator.soem_master import (
    ERROR,
    LONGEST_RUN,
    OP,
    PATIENCE,
    PREOP,
    SAFEOP,
    TIMEOUT,
    assign,
    cycle,
    enabled,
    operational,
    pysoem,
    soem_master,
    states,
    statusword,
)

INTERFACE = f"sg{os.getpid() % 10**7}"
ANALOG_INPUT = Struct("<Hh")


def make_twin() -> Machine:
    return TwinMachine(Twin(RobotParameters(), RealityGap(), np.random.default_rng(0)))


@pytest.fixture(scope="module", autouse=True)
def _network() -> None:
    try:
        with wire(INTERFACE):
            pass
    except NoNetwork as reason:
        pytest.skip(str(reason))


@contextmanager
def master(settings: RingSettings, make_machine: Callable[[], Machine] = Flywheels) -> Iterator[Any]:
    """SOEM on an emulated ring, its slaves found, the drives' PDOs assigned."""
    with emulated(INTERFACE, make_machine, settings), soem_master(INTERFACE) as bus:
        yield bus


def counts(bus: Any) -> list[int]:
    """Fields of a `HopperReading`, with the contact force in counts."""
    motors = [DRIVE_INPUT.unpack(bus.slaves[drive].input)[0] for drive in DRIVES]
    boom = [ENCODER_INPUT.unpack(bus.slaves[encoder].input)[1] for encoder in ENCODERS]
    return [*motors, *boom, ANALOG_INPUT.unpack(bus.slaves[5].input)[1]]


def test_soem_brings_the_ring_up():
    with master(RingSettings()) as bus:
        operational(bus)
        assert states(bus) == [(OP, 0)] * 6
        assert bus.expected_wkc == 4 * 3 + 1
        assert [(len(slave.output), len(slave.input)) for slave in bus.slaves] == list(LENGTHS)
        assert [(slave.man, slave.name) for slave in bus.slaves] == [
            (0x9A, "Gold drive"),
            (0x9A, "Gold drive"),
            (2, "EK1100"),
            (2, "EL5151"),
            (2, "EL5151"),
            (2, "EL3101"),
        ]
        assert bus.slaves[0].sdo_read(0x1018, 2) == pack("<I", bus.slaves[0].id)
        assert bus.slaves[0].sdo_read(0x1008, 0) == b"Gold drive"
        with pytest.raises(pysoem.SdoError) as refused:
            bus.slaves[0].sdo_read(0x2000, 0)
        assert refused.value.abort_code == 0x06020000


def test_the_ring_moves_the_twin_as_direct_calls_do():
    rng = np.random.default_rng(1)
    torques = rng.integers(-300, 300, size=(400, 2)).tolist()
    twin = make_twin()
    with master(RingSettings(inputs_after_tick=True), make_twin) as bus:
        enabled(bus)
        twin.start()
        twin.tick((0, 0))  # as when the drives were enabled
        for torque_1, torque_2 in torques:
            assert cycle(bus, torque_1, torque_2, timeout=PATIENCE) == bus.expected_wkc
            reading = twin.tick((torque_1 * 0.016, torque_2 * 0.016))
            assert counts(bus) == [*reading[:4], round(reading[4] / 0.1)]


def test_a_wrong_mapping_is_refused():
    with master(RingSettings(faults=(Fault("wrong mapping", 0, "drive_2"),))) as bus:
        with pytest.raises(pysoem.SdoError):
            assign(bus.slaves[0], 0x1C12, 0x1607)
        assign(bus.slaves[0], 0x1C12, 0x1602, 0x160B)
        bus.config_map()
        bus.state_check(SAFEOP, TIMEOUT)
        assert states(bus)[1] == (PREOP | ERROR, 0x1E)


def test_missing_frames_end_torque_and_are_reported():
    with master(RingSettings(faults=(Fault("silence", 10, ticks=200),))) as bus:
        enabled(bus)
        for _ in range(8):
            cycle(bus, 100, 100)
        assert states(bus)[:2] == [(SAFEOP | ERROR, 0x1B)] * 2
        assert [statusword(bus, drive) & 0x4F for drive in DRIVES] == [0x08, 0x08]
        bus.slaves[0].mbx_receive()
        assert bus.emergencies == [0x8130]


def test_lost_frames_are_timeouts_without_consequences():
    with master(RingSettings(faults=(Fault("lost frames", 8, cycles=3),))) as bus:
        enabled(bus)
        counters = [cycle(bus, 10, 10) for _ in range(10)]
        assert counters.count(-1) == 3
        assert counters[-1] == bus.expected_wkc
        assert states(bus) == [(OP, 0)] * 6


def test_a_drive_fault_is_in_the_statusword():
    with master(RingSettings(faults=(Fault("trip", 8, "drive_1", code=0x2310),))) as bus:
        enabled(bus)
        for _ in range(8):
            cycle(bus, 10, 10)
        assert [statusword(bus, drive) & 0x4F for drive in DRIVES] == [0x08, 0x07]
        assert bus.slaves[0].sdo_read(0x603F, 0) == pack("<H", 0x2310)


def test_a_slave_that_was_disconnected_is_detected_as_lost():
    with master(RingSettings(faults=(Fault("power lost", 8, "contact_force", cycles=3),))) as bus:
        enabled(bus)
        counters = [cycle(bus, 10, 10) for _ in range(8)]
        assert counters[-1] == bus.expected_wkc - 1
        bus.read_state()
        assert [slave.state for slave in bus.slaves] == [OP] * 5 + [0]


def test_on_the_wall_clock_time_advances_without_frames():
    with master(RingSettings(lock_step=False)) as bus:
        enabled(bus)
        before = counts(bus)
        assert any(cycle(bus, 100, 100) > 0 and counts(bus) != before for _ in range(LONGEST_RUN))
        lost = [(SAFEOP | ERROR, 0x1B)] * 2
        assert any(states(bus)[:2] == lost for _ in range(LONGEST_RUN))  # to read a state feeds no watchdog


# ---- the network


def interfaces() -> set[str]:
    return not_of_other_tests(path.name for path in Path("/sys/class/net").iterdir())


def not_of_other_tests(names: Iterable[str]) -> set[str]:
    """Without the rings of tests that run at the same time in other processes."""
    return {name for name in names if name.startswith(INTERFACE) or not name.startswith("sg")}


def test_the_interfaces_are_deleted():
    with emulated(INTERFACE, Flywheels, RingSettings()):
        assert INTERFACE in interfaces()
    assert INTERFACE not in interfaces()


def test_an_existing_ring_is_reported():
    refused = pytest.raises(NoNetwork, match=f"{INTERFACE}.*exists; end the emulator that uses it")
    with wire(INTERFACE), refused, emulated(INTERFACE, Flywheels, RingSettings()):
        pass


def test_a_name_too_long_is_refused():
    with pytest.raises(NoNetwork, match="1 to 10 characters"), wire("eleven-long"):
        pass


def test_a_missing_interface_is_reported():
    with pytest.raises(NoNetwork, match="'nothing-there' cannot be used: No such device"):
        raw_socket("nothing-there")


PROGRAM = """
from functools import partial
from stepgap.hardware.ethercat.emulator.emulator import run_emulator
from stepgap.hardware.ethercat.emulator.ring_settings import RingSettings
from tests.hardware.ethercat.emulator.bench import Flywheels
run_emulator({interface!r}, Flywheels(), RingSettings(), partial(print, flush=True))
"""
APART = """
import sys
from stepgap.hardware.ethercat.emulator.network import NoNetwork, run_in_namespace
try:
    run_in_namespace([sys.executable, "-c", {program!r}])
except NoNetwork as reason:
    print(reason)
"""


def run_program(program: str) -> subprocess.Popen[str]:
    root = Path(__file__).parents[4]
    return subprocess.Popen([sys.executable, "-c", program], cwd=root, stdout=subprocess.PIPE, text=True)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_ends_it_and_deletes_the_interface(number):
    with run_program(PROGRAM.format(interface=INTERFACE)) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == (
            f"EtherCAT ring on {INTERFACE}: drive_1, drive_2, coupler, boom_horizontal, boom_vertical, contact_force\n"
        )
        process.send_signal(number)
        assert process.wait() == 0
    assert INTERFACE not in interfaces()


def test_a_killed_ring_leaves_no_interface():
    with run_program(PROGRAM.format(interface=INTERFACE)) as process:
        assert process.stdout is not None
        assert process.stdout.readline().startswith("EtherCAT ring")
        process.kill()
    for _ in range(500):  # the kernel takes a namespace away when it has time
        if INTERFACE not in interfaces():
            break
        time.sleep(0.02)
    assert INTERFACE not in interfaces()
    with wire(INTERFACE):
        assert INTERFACE in interfaces()


def test_a_thread_is_back_in_its_network_while_the_ring_is_in_another():
    before = interfaces()
    with wire(INTERFACE):
        assert interfaces() == before | {INTERFACE}
        assert not_of_other_tests(name for _, name in socket.if_nameindex()) == interfaces()


def test_without_a_new_namespace_both_ends_are_in_one(monkeypatch):
    """As in a container with CAP_NET_ADMIN alone."""
    monkeypatch.setattr("stepgap.hardware.ethercat.emulator.network.CLONE_NEWNET", 1)  # which unshare refuses
    with wire(INTERFACE):
        assert {INTERFACE, f"{INTERFACE}-ring"} <= interfaces()
    assert not {INTERFACE, f"{INTERFACE}-ring"} & interfaces()


def test_a_separate_namespace_hides_it():
    with run_program(APART.format(program=PROGRAM.format(interface=INTERFACE))) as process:
        assert process.stdout is not None
        line = process.stdout.readline()
        if not line.startswith("EtherCAT ring"):
            pytest.skip(line)
        assert INTERFACE not in interfaces()
        process.terminate()
        assert process.wait() == 0

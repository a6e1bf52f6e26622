"""The ring over a veth pair, with SOEM (pysoem) as its master and the twin behind the drives."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterable
from pathlib import Path

import pytest

from stepgap.hardware.ethercat.emulator.emulator import emulated
from stepgap.hardware.ethercat.emulator.network import NoNetwork, raw_socket, wire
from stepgap.hardware.ethercat.emulator.ring_settings import RingSettings
from tests.hardware.ethercat.emulator.bench import Flywheels
from tests.hardware.ethercat.emulator.soem_master import (
    ERROR,
    LONGEST_RUN,
    SAFEOP,
    cycle,
    enabled,
    soem_master,
    states,
)

INTERFACE = f"sg{os.getpid() % 10**7}"


@pytest.fixture(scope="module", autouse=True)
def _network() -> None:
    try:
        with wire(INTERFACE):
            pass
    except NoNetwork as reason:
        pytest.skip(str(reason))


def test_on_the_wall_clock_time_advances_without_frames():
    with emulated(INTERFACE, Flywheels, RingSettings(lock_step=False)), soem_master(INTERFACE) as bus:
        enabled(bus)
        before = [slave.input for slave in bus.slaves]
        assert any(
            cycle(bus, 100, 100) > 0 and [slave.input for slave in bus.slaves] != before for _ in range(LONGEST_RUN)
        )
        lost = [(SAFEOP | ERROR, 0x1B)] * 2
        assert any(states(bus)[:2] == lost for _ in range(LONGEST_RUN))  # to read a state feeds no watchdog
    assert INTERFACE not in interfaces()


# ---- the network


def interfaces() -> set[str]:
    return not_of_other_tests(path.name for path in Path("/sys/class/net").iterdir())


def not_of_other_tests(names: Iterable[str]) -> set[str]:
    """Without the rings of tests that run at the same time in other processes."""
    return {name for name in names if name.startswith(INTERFACE) or not name.startswith("sg")}


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

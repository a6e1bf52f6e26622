"""An emulated ring with the twin behind it, for a master that uses it like hardware."""

import os
import shlex
import signal
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import fields
from functools import partial
from math import isinf
from pathlib import Path

import numpy as np
import tomli_w

from stepgap.base.child_environment import environment_of_user
from stepgap.base.errors import InputError
from stepgap.base.files import create
from stepgap.base.settings_file import to_table
from stepgap.base.signals import handled
from stepgap.hardware.ethercat.emulator.emulator import emulated, run_emulator
from stepgap.hardware.ethercat.emulator.network import NoNetwork, run_in_namespace
from stepgap.hardware.ethercat.emulator.ring_settings import RingSettings
from stepgap.hardware.hopper.ring_rig import emulated_settings
from stepgap.hardware.hopper.twin_machine import TwinMachine
from stepgap.robots.hopper.robot import Hopper
from stepgap.robots.hopper.tick.sensors import HopperSensorModel
from stepgap.robots.hopper.twin.model import GroundProfile
from stepgap.robots.hopper.twin.twin import Twin


def emulate_ring(
    hopper: Hopper,
    seed: int,
    ring: RingSettings,
    interface: str,
    hold: float,
    settings_file: Path,
    program: Sequence[str],
) -> int:
    """Emulates a ring until Ctrl-C, or while a command is running; returns the exit code of the command, or 0.

    Args:
        hopper: The robot, with the gap of the twin.
        seed: Seed of its noise.
        ring: Settings of the ring.
        interface: Network interface that a master opens.
        hold: Time for which the twin is held after the drives have been enabled [s].
        settings_file: File for the rig.toml of this ring.
        program: Command line of the command; empty for none.

    Raises:
        InputError: No twin behind a ring can be made with the settings, or the settings file exists already.
        NoNetwork: No ring can run on this computer; the message gives the remedy.
    """
    if os.geteuid() != 0:
        _leave_for_namespace(settings_file, program)
    make_machine = partial(_make_machine, hopper, seed, hold)
    sensors = _sensors_behind_ring(hopper, hold)
    text = tomli_w.dumps(to_table(emulated_settings(sensors, hopper.parameters, ring, interface, hopper.ground)))
    _has_settings(settings_file, text)  # a file that describes another rig is refused before the ring starts

    def started(line: str) -> None:
        _write_settings(settings_file, text)
        print(f"{line}; Ctrl-C ends it", flush=True)

    if not program:
        run_emulator(interface, make_machine(), ring, started)
        return 0
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)  # inherited by the ring: Ctrl-C is for the program
    with emulated(interface, make_machine, ring):
        signal.signal(signal.SIGINT, before)
        _write_settings(settings_file, text)
        return run_program(program)


def run_program(program: Sequence[str]) -> int:
    """Runs a command until it ends, also by Ctrl-C or SIGTERM; returns its exit code as in shells.

    Raises:
        InputError: There is no such program.
    """
    try:
        process = subprocess.Popen(program, env=environment_of_user())
    except OSError as error:
        raise InputError(f"-- {shlex.join(program)}: cannot be run: {error.strerror}") from None

    def forward(number: int, _: object) -> None:
        if number == signal.SIGTERM:  # which reaches only this process; a terminal's signals reach the program, too
            process.terminate()

    with handled(forward):
        while True:
            try:
                code = process.wait()
                return code if code >= 0 else 128 - code
            except KeyboardInterrupt:
                continue  # the program was interrupted, too


def _make_machine(hopper: Hopper, seed: int, hold: float) -> TwinMachine:
    """The twin behind the ring; its code is compiled, which takes seconds once, before a frame waits for an answer."""
    machine, other = (TwinMachine(_twin(hopper, seed, hold)) for _ in range(2))
    other.start()
    other.tick((0.0, 0.0))
    return machine


def _twin(hopper: Hopper, seed: int, hold: float) -> Twin:
    """The twin on its ground, which is drawn with its noise."""
    rng = np.random.default_rng(seed)
    ground = GroundProfile(hopper.gap, hopper.parameters.boom_length, rng, hopper.ground)
    return Twin(hopper.parameters, hopper.gap, rng, hold=hold, ground=ground)


def _sensors_behind_ring(hopper: Hopper, hold: float) -> HopperSensorModel:
    """Sensor model of the twin, after a check that a ring can carry its counts."""
    for name in (field.name for field in fields(hopper.gap) if "counts" in field.name):
        if isinf(getattr(hopper.gap, name)):
            raise InputError(
                f"[gap] {name} = inf: a ring carries integer counts; give a number, such as --gap.{name} 16384"
            )
    try:
        return _twin(hopper, 0, hold).sensor_model
    except ValueError as error:
        tables = "[parameters], [gap] and [ground]"
        raise InputError(f"no twin can be made with the settings {tables}: {error}") from None


def _has_settings(file: Path, text: str) -> bool:
    """Whether a file exists, with this content; InputError if it has another."""
    try:
        if not file.is_file():
            return False
        if file.read_text("utf-8") == text:
            return True
    except UnicodeDecodeError:
        raise InputError(f"{file}: exists and is not a text file; choose another --settings") from None
    except OSError as error:
        raise InputError(f"{file}: cannot be read: {error.strerror}; choose another --settings") from None
    raise InputError(f"{file}: exists and describes another rig; choose another --settings")


def _write_settings(file: Path, text: str) -> None:
    """Writes rig.toml and prints its path, unless the file exists with the same content."""
    if _has_settings(file, text):
        return
    try:
        create(file, text)
    except FileExistsError:
        raise InputError(f"{file}: exists and describes another rig; choose another --settings") from None
    except OSError as error:
        raise InputError(f"{file}: cannot be written: {error.strerror}; choose another --settings") from None
    print(file, flush=True)


def _leave_for_namespace(settings_file: Path, program: Sequence[str]) -> None:
    """Continues in a network namespace, which does not need root; the program is needed there as the master."""
    if not program:
        master = shlex.join(["stepgap", "rig", "check", str(settings_file)])
        typed = shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]])
        raise NoNetwork(
            "only root can make a network interface; without root, ring and master must share a private network: "
            f"type `{typed} -- {master}`, or any other command after --"
        )
    run_in_namespace([sys.executable, *sys.orig_argv[1:]])

"""The ring with a master that is independent of this project and of SOEM: KickCAT."""

from struct import unpack

import numpy as np
import pytest

from stepgap.hardware.ethercat.emulator.faults import Fault
from tests.hardware.ethercat.emulator.bench import DRIVE_INPUT, DRIVES, ENCODER_INPUT, ENCODERS, LENGTHS
from tests.hardware.ethercat.emulator.kickcat_master import WATCHDOG, KickcatMaster
from tests.hardware.ethercat.ring_process import INTERFACE, live_ring

BEFORE = 2
"""Frames with outputs until OP."""

FOR_A_FRAME = 0.25
"""Time that KickCAT waits for a frame that does not come [s]."""


def test_kickcat_finds_the_slaves_and_brings_them_to_op():
    with live_ring() as ring:
        master = KickcatMaster(INTERFACE)
        states = master.kickcat.State
        assert [slave.address for slave in master.slaves] == [1001, 1002, 1003, 1004, 1005, 1006]
        assert [master.bus.get_state(slave) for slave in master.slaves] == [states.PREOP] * 6
        master.assign_pdos()
        master.operational()
        assert [(slave.output_size, slave.input_size) for slave in master.slaves] == list(LENGTHS)
        assert [master.bus.get_state(slave) for slave in master.slaves] == [states.OPERATIONAL] * 6
        assert ring.look().cycles == BEFORE
        master.change(states.PREOP)
        assert [master.bus.get_state(slave) for slave in master.slaves] == [states.PREOP] * 6


def test_torques_and_sensors_are_what_kickcat_sent_and_received():
    torques = np.random.default_rng(0).integers(-2000, 2000, size=(200, 2)).tolist()
    with live_ring() as ring:
        master = KickcatMaster(INTERFACE)
        master.assign_pdos()
        master.operational()
        master.enable()
        before = (0, 0)
        for ticks, (torque_1, torque_2) in enumerate(torques, 1):
            master.cycle(torque_1, torque_2)  # reads, then writes: the inputs are those of the tick before
            drives = [DRIVE_INPUT.unpack(master.slaves[drive].input_data) for drive in DRIVES]
            encoders = [ENCODER_INPUT.unpack(master.slaves[encoder].input_data) for encoder in ENCODERS]
            assert [drive[:2] for drive in drives] == [(ticks, before[0]), (10 * ticks, before[1])]
            assert [drive[2] & 0x6F for drive in drives] == [0x27, 0x27]
            assert encoders == [(0, -ticks, 0), (0, 2 * ticks, 0)]
            assert unpack("<Hh", master.slaves[5].input_data) == (0, 5 * ticks)
            before = torque_1, torque_2
        counts = [[round(torque / 0.016) for torque in tick] for tick in ring.look().torques]
        assert counts == [[0, 0], *torques]


def test_kickcat_detects_lost_frames_and_lost_slaves():
    with live_ring(Fault("lost frames", BEFORE + 1), Fault("power lost", BEFORE + 3, "contact_force", cycles=2)):
        master = KickcatMaster(INTERFACE)
        master.assign_pdos()
        master.operational()
        master.cycle()
        with pytest.raises(RuntimeError, match="write error: datagram state is LOST"):
            master.cycle(wait=FOR_A_FRAME)
        master.cycle()
        master.cycle()  # the terminal has no outputs
        with pytest.raises(RuntimeError, match="read error: datagram state is INVALID_WKC"):
            master.cycle()


def test_the_watchdog_is_as_long_as_kickcat_sets_it():
    ticks = round(WATCHDOG * 1000)
    with live_ring(Fault("silence", BEFORE + 1, ticks=ticks - 1), Fault("silence", BEFORE + 2, ticks=ticks + 1)):
        master = KickcatMaster(INTERFACE)
        master.assign_pdos()
        master.operational()
        master.cycle()
        master.cycle()
        assert master.bus.get_state(master.slaves[0]) == master.kickcat.State.OPERATIONAL
        master.cycle()
        with pytest.raises(master.kickcat.ErrorAL):
            master.bus.get_state(master.slaves[0])

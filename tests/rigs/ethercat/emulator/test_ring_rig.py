"""The whole path through the ring, tick by tick beside direct calls of the twin."""

import numpy as np
import pytest

from stepgap.hopper import CommandBounds, Gains, RobotParameters
from stepgap.plants.rig_plant import RigPlant
from stepgap.rigs.ethercat.emulator.machine import TwinMachine
from stepgap.rigs.ethercat.emulator.ring import RingSettings
from stepgap.rigs.ethercat.emulator.ring_rig import RingRig, emulated_settings
from stepgap.rigs.rig import Rig, RigFault
from stepgap.rigs.twin.reality_gap import RealityGap
from stepgap.rigs.twin.twin import Twin
from stepgap.step import Reason
from tests.rigs.ethercat.ring_process import INTERFACE

pytest.importorskip("pysoem", reason="pysoem is locked for Linux only")

ROBOT, GAINS, BOUNDS = RobotParameters(), Gains(), CommandBounds()
RING = RingSettings(inputs_after_tick=True)
HOPS = 4


def twin() -> Twin:
    return Twin(ROBOT, RealityGap(), np.random.default_rng(3))


def machine() -> TwinMachine:
    return TwinMachine(twin())


SETTINGS = emulated_settings(twin().layout, ROBOT, RING, INTERFACE)


class Quantised(Rig):
    """The twin called directly, with torques and contact force in the ring's counts, and the tick without torque in
    which its drives are enabled."""

    def __init__(self) -> None:
        self._twin, self._motor = twin(), SETTINGS.motor_1

    @property
    def layout(self):
        return self._twin.layout

    @property
    def limits(self):
        return SETTINGS.limits

    def connect(self):
        self._twin.connect()
        self._twin.write(0.0, 0.0)

    def read(self):
        reading, unit = self._twin.read(), RING.force_resolution
        return reading._replace(contact_force=unit * min(max(round(reading.contact_force / unit), -32768), 32767))

    def write(self, torque_1, torque_2):
        unit, most = self._motor.torque_unit, self._motor.most_units
        units = [min(max(round(torque / unit), -most), most) for torque in (torque_1, torque_2)]
        self._twin.write(*(count * RING.rated_torque * 1e-6 for count in units))
        return units[0] * unit, units[1] * unit

    def close(self):
        self._twin.close()


def hop(rig: Rig):
    ticks, states = [], []
    with RigPlant(rig, ROBOT, GAINS, BOUNDS, on_tick=lambda tick: ticks.append(tick.row())) as plant:
        try:
            states.append(plant.start())
        except RigFault as fault:
            if "raw Ethernet needs" in str(fault):
                pytest.skip(str(fault))
            raise
        for _ in range(HOPS):
            record = plant.take_step(np.array([-4.0, -6.0]))
            assert record.reason == Reason.OK
            states.append(record.next_state)
    return np.array(ticks), np.array(states)


def test_through_the_ring_every_tick_is_that_of_direct_calls_but_for_quantisation():
    ticks, states = hop(RingRig(machine, RING, SETTINGS, ROBOT))
    wanted_ticks, wanted_states = hop(Quantised())
    np.testing.assert_array_equal(ticks, wanted_ticks)
    np.testing.assert_array_equal(states, wanted_states)
    _, exact = hop(twin())
    assert np.abs(states - exact).max(axis=0) == pytest.approx([0, 0], abs=0.03), "counts change little"


def test_a_ring_rig_can_be_had_again():
    rig = RingRig(machine, RING, SETTINGS, ROBOT)
    for _ in range(2):
        try:
            rig.connect()
        except RigFault as fault:
            pytest.skip(str(fault))
        assert rig.read().boom_horizontal == 0
        rig.write(1.0, 1.0)
        rig.close()
        rig.close()
        with pytest.raises(RigFault, match="not connected"):
            rig.read()

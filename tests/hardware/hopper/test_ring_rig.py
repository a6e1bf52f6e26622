"""The whole path through the ring, compared tick by tick with direct calls of the twin."""

from dataclasses import replace

import numpy as np
import pytest

from stepgap.hardware.ethercat.emulator.ring_settings import RingSettings
from stepgap.hardware.hopper.ring_rig import RingRig, emulated_settings
from stepgap.hardware.hopper.ring_simulation import DirectRing
from stepgap.hardware.hopper.twin_machine import TwinMachine
from stepgap.plants.rig_plant import RigPlant
from stepgap.rigs.rig import Rig, RigFault
from stepgap.robots.hopper import CommandBounds, Gains, RobotParameters
from stepgap.robots.hopper.tick.hop_control import HopperControl
from stepgap.robots.hopper.twin.reality_gap import RealityGap
from stepgap.robots.hopper.twin.twin import Twin
from stepgap.step import StepStatus
from tests.hardware.ethercat.emulator.bench import Flywheels
from tests.hardware.ethercat.ring_process import INTERFACE, skipping_without_network

pytest.importorskip("pysoem", reason="pysoem is locked for Linux only")

ROBOT, GAINS, BOUNDS = RobotParameters(), Gains(), CommandBounds()
RING = RingSettings(inputs_after_tick=True)
HOPS = 2


def twin() -> Twin:
    return Twin(ROBOT, RealityGap(), np.random.default_rng(3))


def machine() -> TwinMachine:
    return TwinMachine(twin())


SETTINGS = emulated_settings(twin().sensor_model, ROBOT, RING, INTERFACE)


def hop(rig: Rig):
    ticks, states = [], []
    with RigPlant(rig, HopperControl(ROBOT, GAINS, BOUNDS), on_ticks=lambda got, step: ticks.extend(got)) as plant:
        with skipping_without_network():
            states.append(plant.start())
        for _ in range(HOPS):
            record = plant.take_step(np.array([-4.0, -6.0]))
            assert record.status == StepStatus.OK
            states.append(record.next_state)
    return np.array(ticks), np.array(states)


def test_through_the_ring_every_tick_equals_that_of_direct_calls_except_for_quantisation():
    ticks, states = hop(RingRig(machine, RING, SETTINGS, ROBOT))
    wanted_ticks, wanted_states = hop(DirectRing(twin(), RING, SETTINGS))
    np.testing.assert_array_equal(ticks, wanted_ticks)
    np.testing.assert_array_equal(states, wanted_states)
    _, exact = hop(twin())
    assert np.abs(states - exact).max(axis=0) == pytest.approx([0, 0], abs=0.03), "counts change little"


def test_a_ring_rig_can_be_connected_again():
    rig = RingRig(Flywheels, RING, SETTINGS, ROBOT)
    for _ in range(2):
        with skipping_without_network():
            rig.connect()
        assert rig.read()[:2] == (0, 0), "flywheels that nothing has moved"
        rig.write((1.0, 1.0))
        rig.close()
        rig.close()
        with pytest.raises(RigFault, match="not connected"):
            rig.read()


def test_a_bus_that_cannot_be_brought_up_leaves_no_ring() -> None:
    first, *others = SETTINGS.slaves
    wrong = RingRig(Flywheels, RING, replace(SETTINGS, slaves=(replace(first, product=1), *others)), ROBOT)
    with pytest.raises(RigFault, match="product"), skipping_without_network():
        wrong.connect()
    with RingRig(Flywheels, RING, SETTINGS, ROBOT) as rig:  # on the same interface
        assert rig.read()[:2] == (0, 0)

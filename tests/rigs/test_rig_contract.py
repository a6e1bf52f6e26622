"""Every rig keeps the contract."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest

from stepgap.hardware.hopper.moteus import hopper_on_moteus
from stepgap.rigs.rig import Rig
from stepgap.robots.hopper.parameters import RobotParameters
from stepgap.robots.hopper.twin.reality_gap import RealityGap
from stepgap.robots.hopper.twin.twin import Twin
from tests.hardware.ethercat.ring_process import Recorder, live_ring
from tests.hardware.moteus.emulated_moteus import emulated
from tests.hardware.moteus.test_moteus_rig import SETTINGS, fresh
from tests.rigs.rig_contract import MakeRig, RigContract

ROBOT = RobotParameters()


class TestTwin(RigContract):
    torque_limit = ROBOT.torque_limit

    @pytest.fixture
    def make_rig(self) -> MakeRig:
        @contextmanager
        def make() -> Iterator[Rig]:
            yield Twin(ROBOT, replace(RealityGap(), torque_limit=np.inf), np.random.default_rng(0))

        return make


class TestEthercat(RigContract):
    torque_limit, torque_unit = 20.0, 0.016

    @pytest.fixture
    def make_rig(self) -> MakeRig:
        pytest.importorskip("pysoem", reason="pysoem is locked for Linux only")
        from tests.hardware.ethercat.test_ethercat_rig import rig_of

        @contextmanager
        def make() -> Iterator[Rig]:
            with live_ring():
                yield rig_of()

        return make


class TestMoteus(RigContract):
    torque_limit = SETTINGS.motor_1.torque_limit

    @pytest.fixture
    def make_rig(self) -> MakeRig:
        @contextmanager
        def make() -> Iterator[Rig]:
            settings = fresh()
            with emulated(settings, Recorder()):
                yield hopper_on_moteus(settings, ROBOT)

        return make

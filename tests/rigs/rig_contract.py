"""The contract of every `Rig`: a self-contained file that can be copied to a package with its own rig.

Subclass `RigContract` as `Test…` and give it `make_rig`: a context manager of a rig that is not connected yet.
"""

from collections.abc import Callable
from contextlib import AbstractContextManager
from math import inf, isfinite, nan

import pytest

from stepgap.rigs.rig import Reading, Rig, RigFault
from stepgap.robots.hopper.tick.sensors import HopperReading, HopperSensorModel

MakeRig = Callable[[], AbstractContextManager[Rig]]


def moved(rig: Rig, ticks: int, torque_1: float = 0.0, torque_2: float = 0.0) -> Reading:
    """The reading after some ticks."""
    for _ in range(ticks):
        rig.read()
        rig.write((torque_1, torque_2))
    return rig.read()


def break_off(rig: Rig) -> None:
    """Uses the rig in a block that ends in an error."""
    with rig:
        moved(rig, 1)
        raise ZeroDivisionError


class RigContract:
    """Tests of a rig that `make_rig` makes.

    Attributes:
        torque_limit: Largest torque that the rig gives [N·m].
        torque_unit: Resolution of its torques [N·m].
    """

    torque_limit: float
    torque_unit: float = 1e-6

    @pytest.fixture
    def make_rig(self) -> MakeRig:
        raise NotImplementedError

    def test_the_sensor_model_is_known_at_once_and_does_not_change(self, make_rig: MakeRig) -> None:
        with make_rig() as rig:
            model = rig.sensor_model
            assert isinstance(model, HopperSensorModel)
            counts = (model.motor_counts, model.boom_counts_horizontal, model.boom_counts_vertical)
            assert all(isfinite(value) and value > 0 for value in (model.tick, model.boom_length, *counts))
            assert isfinite(model.pivot_height)
            assert isfinite(model.touchdown_force)
            assert model.takeoff_length > 0
            rig.connect()
            moved(rig, 2)
            assert rig.sensor_model == model
            rig.close()

    def test_it_does_nothing_until_connected(self, make_rig: MakeRig) -> None:
        with make_rig() as rig:
            with pytest.raises(RigFault):
                rig.read()
            with pytest.raises(RigFault):
                rig.write((0.0, 0.0))
            rig.close()

    def test_readings_are_finite_and_do_not_change_within_a_tick(self, make_rig: MakeRig) -> None:
        with make_rig() as rig, rig:
            first = rig.read()
            assert isinstance(first, HopperReading)
            assert rig.read() == first
            for _ in range(20):
                assert all(map(isfinite, moved(rig, 1)))

    def test_it_returns_the_applied_torques(self, make_rig: MakeRig) -> None:
        with make_rig() as rig, rig:
            for commanded in ((0.0, 0.0), (1.234, -0.5), (-2.0, 3.0)):
                rig.read()
                assert rig.write(commanded) == pytest.approx(commanded, abs=self.torque_unit)

    def test_torque_is_limited_and_the_limited_one_is_returned(self, make_rig: MakeRig) -> None:
        with make_rig() as rig, rig:
            for commanded in ((1e3, -1e3), (-1e30, 0.0)):
                rig.read()
                applied = rig.write(commanded)
                limited = [min(max(torque, -self.torque_limit), self.torque_limit) for torque in commanded]
                assert applied == pytest.approx(limited, abs=self.torque_unit)
                assert max(map(abs, applied)) <= self.torque_limit

    @pytest.mark.parametrize("torques", [(nan, 0.0), (0.0, inf), (-inf, nan)])
    def test_a_torque_that_is_not_finite_stops_it_for_good(
        self, make_rig: MakeRig, torques: tuple[float, float]
    ) -> None:
        with make_rig() as rig:
            rig.connect()
            moved(rig, 2, 1.0, 1.0)
            with pytest.raises(RigFault, match="finite") as fault:
                rig.write(torques)
            assert "\n" not in str(fault.value)
            for _ in range(2):
                with pytest.raises(RigFault):
                    rig.write((0.0, 0.0))
            rig.close()

    def test_it_may_be_closed_twice_and_connected_again(self, make_rig: MakeRig) -> None:
        with make_rig() as rig:
            for _ in range(2):
                rig.connect()
                moved(rig, 3, 0.5, 0.5)
                rig.close()
                rig.close()
                with pytest.raises(RigFault):
                    rig.read()
                with pytest.raises(RigFault):
                    rig.write((0.0, 0.0))

    def test_it_is_closed_when_the_block_ends_in_an_error(self, make_rig: MakeRig) -> None:
        with make_rig() as rig:
            with pytest.raises(ZeroDivisionError):
                break_off(rig)
            with pytest.raises(RigFault):
                rig.write((0.0, 0.0))

"""What every `Rig` must do; one file without ties, so that it can be copied beside a rig of one's own.

Subclass `RigContract` as `Test…` and give it `make_rig`: a context manager of a rig that is not connected yet.
"""

from collections.abc import Callable
from contextlib import AbstractContextManager
from math import inf, isfinite, nan

import pytest

from stepgap.rigs.rig import Reading, Rig, RigFault
from stepgap.robots.hopper.sensors import HopperReading, HopperSensorModel

MakeRig = Callable[[], AbstractContextManager[Rig]]


def moved(rig: Rig, ticks: int, torque_1: float = 0.0, torque_2: float = 0.0) -> Reading:
    """The reading after some ticks."""
    for _ in range(ticks):
        rig.read()
        rig.write((torque_1, torque_2))
    return rig.read()


def break_off(rig: Rig) -> None:
    """Uses the rig and runs into an error."""
    with rig:
        moved(rig, 1)
        raise ZeroDivisionError


class RigContract:
    """Tests of a rig that `make_rig` makes.

    Attributes:
        torque_limit: Largest torque that the rig gives [N·m].
        torque_unit: Fineness of its torques [N·m].
    """

    torque_limit: float
    torque_unit: float = 1e-6

    @pytest.fixture
    def make_rig(self) -> MakeRig:
        raise NotImplementedError

    def test_the_layout_is_known_at_once_and_stays(self, make_rig: MakeRig) -> None:
        with make_rig() as rig:
            layout = rig.sensor_model
            assert isinstance(layout, HopperSensorModel)
            counts = (layout.motor_counts, layout.boom_counts_horizontal, layout.boom_counts_vertical)
            assert all(isfinite(value) and value > 0 for value in (layout.tick, layout.boom_length, *counts))
            assert isfinite(layout.pivot_height)
            assert isfinite(layout.touchdown_force)
            assert layout.takeoff_length > 0
            rig.connect()
            moved(rig, 2)
            assert rig.sensor_model == layout
            rig.close()

    def test_it_does_nothing_until_connected(self, make_rig: MakeRig) -> None:
        with make_rig() as rig:
            with pytest.raises(RigFault):
                rig.read()
            with pytest.raises(RigFault):
                rig.write((0.0, 0.0))
            rig.close()

    def test_readings_are_numbers_and_stay_until_a_tick_passes(self, make_rig: MakeRig) -> None:
        with make_rig() as rig, rig:
            first = rig.read()
            assert isinstance(first, HopperReading)
            assert rig.read() == first
            for _ in range(20):
                assert all(map(isfinite, moved(rig, 1)))

    def test_it_says_what_it_applied(self, make_rig: MakeRig) -> None:
        with make_rig() as rig, rig:
            for asked in ((0.0, 0.0), (1.234, -0.5), (-2.0, 3.0)):
                rig.read()
                assert rig.write(asked) == pytest.approx(asked, abs=self.torque_unit)

    def test_torque_is_limited_and_the_caller_told(self, make_rig: MakeRig) -> None:
        with make_rig() as rig, rig:
            for asked in ((1e3, -1e3), (-1e30, 0.0)):
                rig.read()
                applied = rig.write(asked)
                limited = [min(max(torque, -self.torque_limit), self.torque_limit) for torque in asked]
                assert applied == pytest.approx(limited, abs=self.torque_unit)
                assert max(map(abs, applied)) <= self.torque_limit

    @pytest.mark.parametrize("torques", [(nan, 0.0), (0.0, inf), (-inf, nan)])
    def test_what_is_no_number_stops_it_and_it_stays_stopped(
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

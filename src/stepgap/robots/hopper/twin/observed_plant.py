"""A plant of the twin whose ticks also contain the true state at the reading of their sensors."""

from collections.abc import Callable

from stepgap.plants.compiled_rig import Rows
from stepgap.plants.rig_plant import RigPlant
from stepgap.plants.ticks.stream import OnTicks
from stepgap.rigs.rig import Reading, Rig
from stepgap.rigs.wrapped_rig import WrappedRig
from stepgap.robots.hopper.tick.hop_control import HopperControl
from stepgap.robots.hopper.twin.twin import Twin


def observed_plant(rig: Rig, twin: Twin, control: HopperControl, on_ticks: OnTicks, every: int) -> RigPlant:
    """Plant of a rig that contains the twin.

    Args:
        rig: The rig, in the calling process.
        control: Control of the hopper.
        on_ticks: Called with the kept ticks; the columns are those of `HopperKinematics.observed_units`.
        every: Interval of the kept ticks.
    """
    count = 0
    truth = ()

    def on_read() -> None:
        nonlocal truth
        if count % every == 0:
            truth = _true_columns(twin)

    def on_tick(rows: Rows, step: int) -> None:
        nonlocal count
        (row,) = rows  # an observed rig is not run in compiled code, so its ticks come one by one
        if count % every == 0:
            on_ticks([(*row, *truth)], step)
        count += 1

    return RigPlant(_ObservedRig(rig, on_read), control, on_tick)


def _true_columns(twin: Twin) -> tuple[float, ...]:
    """The true state in the order of `TRUE_UNITS`."""
    true = twin.true_state()
    front, rear = true.leg
    return (*true.hip, *true.boom, (front + rear) / 2, (front - rear) / 2, *true.foot, true.ground_height)


class _ObservedRig(WrappedRig):
    """A rig that reports every reading.

    Args:
        on_read: Called after every reading.
    """

    def __init__(self, rig: Rig, on_read: Callable[[], None]):
        super().__init__(rig)
        self._on_read = on_read

    def read(self) -> Reading:
        reading = self._rig.read()
        self._on_read()
        return reading

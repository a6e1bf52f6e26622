"""A master of an EtherCAT bus that does not spin while it waits: in tests the ring computes on the same processor."""

from select import select

from stepgap.hardware.ethercat.bus import Bus

LONGEST_SLEEP = 3e-3
"""Time for which the master sleeps before it polls as on a real bus [s]; a frame may have come already, or be lost."""


def leave_out_spinning() -> None:
    """From now on the master of this process and of its copies sleeps until a frame comes back."""
    receive = Bus.receive

    def sleeping(self: Bus) -> bool:
        select(self._sockets, [], [], LONGEST_SLEEP)
        return receive(self)

    Bus.receive = sleeping

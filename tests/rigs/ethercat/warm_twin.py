"""Imported by the fork server of rings: the first ticks of a twin load compiled code, which every ring then has."""

from tests.rigs.ethercat.ring_process import RecordedTwin

_twin = RecordedTwin()
_twin.start()
_twin.tick((0.1, 0.0))

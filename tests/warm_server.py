"""Imported by the fork server of tests: what it has imported and computed, its copies need not."""

import gc

import stepgap.sweep.sweep_case  # noqa: F401
from tests.compiled_hops import compile_hops
from tests.hardware.ethercat.ring_process import RecordedTwin
from tests.quick_bus import leave_out_spinning
from tests.quick_disk import leave_out_waiting_for_the_disk
from tests.warm_process import start_processes_from_a_warm_server

start_processes_from_a_warm_server()  # in copies, too
leave_out_waiting_for_the_disk()
leave_out_spinning()
compile_hops()
twin = RecordedTwin()
twin.start()
twin.tick((0.1, 0.0))
gc.freeze()

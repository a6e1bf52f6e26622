"""The engines with which `benchmarks/compare_maps.py` compares the map, and the reference for all errors."""

from collections.abc import Callable
from importlib.util import find_spec
from typing import Any

import numba

from benchmarks.peers import full_system
from benchmarks.speed.step_map import Engine, MapPeers
from stepgap.robots.hopper.model.apex_map import ApexMap


def map_peers(nominal: ApexMap, quick: bool) -> MapPeers:
    """Engines and reference for one map; with `quick`, only the peer that needs no compilation."""
    found, skipped = engines(nominal, quick)
    return MapPeers(found, skipped, reference(nominal, quick))


def reference(nominal: ApexMap, quick: bool) -> Callable[[Any, Any], Any]:
    """SciPy's DOP853 at 1e-12 with short steps; compiled unless there are few points."""
    compiled = full_system.plain if quick else numba.njit
    return full_system.make_hop(nominal.robot, nominal.gains, compiled, 1e-12, 1e-13, max_step=5e-3 if quick else 2e-3)


def engines(nominal: ApexMap, quick: bool) -> tuple[list[Engine], dict[str, str]]:
    """Installed peers, and the reasons why the others are missing."""
    robot, gains, skipped = nominal.robot, nominal.gains, {}
    hop = full_system.make_hop(robot, gains, full_system.plain, 1e-6, 1e-8)
    found = [Engine("SciPy DOP853, NumPy", "full systems, rtol 1e-6", hop, calls=1)]
    if quick:
        return found, dict.fromkeys(("SciPy DOP853, Numba", "heyoka", "numbalsoda", "MuJoCo"), "left out by --quick")
    hop = full_system.make_hop(robot, gains, numba.njit, 1e-6, 1e-8)
    found.append(Engine("SciPy DOP853, Numba", "full systems, rtol 1e-6", hop, calls=5))
    if find_spec("heyoka"):
        from benchmarks.peers import taylor

        hop = taylor.make_hop(robot, gains, 4e-6)
        found.append(Engine("heyoka", "reduced systems, tolerance 4e-6", hop, calls=100))
    else:
        skipped["heyoka"] = "not installed: ./go uv pip install heyoka"
    installed = "installed, but no hop is implemented for it" if find_spec("numbalsoda") else "not installed"
    skipped["numbalsoda"] = installed
    from benchmarks.peers import stepping

    ticks, error = stepping.measure_twin(nominal, robot, gains, hops=10)
    note = f"{ticks} steps of 1 ms, no controller; another contact model; error of the twin over 10 hops"
    found.append(Engine("MuJoCo", note, stepping.make_stepper(robot, ticks), calls=10, error=float(error.max())))
    return found, skipped

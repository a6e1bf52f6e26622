"""Comparison of the nominal map with SciPy, heyoka and MuJoCo, which take turns on one machine.

    ./go python -m benchmarks.compare_maps [--quick] [--out FILE] [--seed 0]

Run from the root of the repository. The table is that of `benchmarks.speed map`, with a row for
each peer that is installed.
"""

import argparse
import json
import sys
from pathlib import Path

from benchmarks.peers.catalogue import map_peers
from benchmarks.speed.step_map import bench_map, describe_map_bench
from stepgap.robots.hopper.model.apex_map import ApexMap


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="run for half a minute, with few points and few peers")
    parser.add_argument("--out", type=Path, help="new JSON file for the result")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    nominal = ApexMap()
    peers = map_peers(nominal, options.quick)
    result = bench_map(nominal, options.seed, options.quick, lambda line: print(f"{line} …", file=sys.stderr), peers)
    print(describe_map_bench(result))
    if options.out:
        with options.out.open("x", encoding="utf-8") as file:
            json.dump(result, file, indent=2)


if __name__ == "__main__":
    main()

"""Comparison of the Gaussian process with scikit-learn and OpenTURNS, which take turns on one machine.

    ./go python -m benchmarks.compare_gaussian_processes [--quick] [--out FILE]

Run from the root of the repository. The table is that of `benchmarks.speed gp`, with a row for each peer
that is installed.
"""

import argparse
import json
import sys
from pathlib import Path

from benchmarks.peers.gaussian_processes import gp_peers
from benchmarks.speed.gaussian_process import bench_gp, describe_gp_bench


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="run for some seconds, with few points and few peers")
    parser.add_argument("--out", type=Path, help="new JSON file for the result")
    options = parser.parse_args()
    peers = gp_peers(options.quick)
    result = bench_gp(0, options.quick, lambda line: print(f"{line} …", file=sys.stderr), peers)
    print(describe_gp_bench(result))
    if options.out:
        with options.out.open("x", encoding="utf-8") as file:
            json.dump(result, file, indent=2)


if __name__ == "__main__":
    main()

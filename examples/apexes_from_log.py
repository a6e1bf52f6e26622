"""Apexes from the log of a hopping robot, as steps for `stepgap fit`; without arguments, from a synthetic log.

The log is one CSV file, or several with the same sampling times, with the body's height and forward position or the
angles of its boom. A parabola fitted around every top gives the height of the apex, and a line the forward speed.
Columns of a plan that has a row for every hop are added to the hops.
"""

import argparse
import csv
import re
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from scipy.signal import find_peaks


def read_columns(files):
    """Columns of all files by name, as strings; the first file with a name is used."""
    columns = {}
    for file in files:
        with Path(file).open(encoding="utf-8", newline="") as stream:
            rows = list(csv.DictReader(stream))
        columns = {name: [row[name] for row in rows] for name in rows[0]} | columns
    if len(set(map(len, columns.values()))) > 1:
        sys.exit(f"{', '.join(map(str, files))}: they have different numbers of rows")
    return columns


def find_apexes(time, height, forward, rise, window):
    """Forward speed and height at every top with prominence `rise`, fitted over `window` seconds on each side."""
    found = []
    for top in find_peaks(height, prominence=rise)[0]:
        near = np.abs(time - time[top]) <= window
        since = time[near] - time[top]
        curvature, rate, level = np.polyfit(since, height[near], 2)
        at = np.clip(-rate / (2 * curvature), -window, window)
        found.append((np.polyfit(since - at, forward[near], 1)[0], level + rate * at + curvature * at**2))
    return np.array(found)


def planned_apexes(plan, gravity, launch_height):
    """Forward speed and height at the top of a ballistic flight, from its launch speed, angle and ground height."""
    speed, angle, ground = plan.T
    return np.stack([speed * np.cos(angle), launch_height + ground + (speed * np.sin(angle)) ** 2 / (2 * gravity)], -1)


def first_number(cell):
    """The first number in a cell, which may be a list such as [2.4 2.1]."""
    return float(re.search(r"[-+]?\d*\.?\d+(?:[eE][-+]?\d+)?", cell)[0])


def steps_of(options):
    """Returns the names of the columns, and a row for every hop except the first."""
    log = read_columns(options.log)
    time, height, forward = (np.array(log[name], float) for name in (options.time, options.height, options.forward))
    if options.boom:
        height, forward = options.boom * np.sin(height), options.boom * forward
    apexes = find_apexes(time, height, forward, options.rise, options.window)
    names, parts = ["speed", "height", "next_speed", "next_height"], [apexes[:-1], apexes[1:]]
    if options.plan:
        texts = read_columns([options.plan])
        chosen = options.plan_columns.split(",")
        plan = np.array([[first_number(cell) for cell in texts[name]] for name in chosen]).T
        if len(plan) != len(apexes):
            sys.exit(f"{options.plan}: {len(plan)} plans for {len(apexes)} hops; change --rise until both are equal")
        names += chosen
        parts.append(plan[1:])
        if options.gravity:
            names += ["predicted_speed", "predicted_height"]
            parts.append(planned_apexes(plan[1:, :3], options.gravity, options.launch_height))
    return names, np.hstack(parts)


def demonstrate(folder):
    """Writes a synthetic log of twelve hops and returns the command line for it."""
    rng, rows, start = np.random.default_rng(0), [], 0.0
    for speed, take_off in zip(rng.uniform(0.1, 0.4, 12), rng.uniform(1.0, 1.4, 12), strict=True):
        for since in np.arange(0, 2 * take_off / 5.2, 0.005):
            forward = start + speed * since
            rows.append(f"{len(rows) * 0.005},{0.5 + take_off * since - 2.6 * since**2},{forward}")
        start = forward
    (folder / "log.csv").write_text("\n".join(["time,height,forward", *rows]))
    return [str(folder / "log.csv")]


def main(arguments):
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("log", nargs="+", help="CSV files with a row for each sampling time")
    parser.add_argument("--time", default="time", help="column of the time [s]")
    parser.add_argument(
        "--height", default="height", help="column of the height [m], or with --boom of the pitch [rad]"
    )
    parser.add_argument(
        "--forward", default="forward", help="column of the position [m], or with --boom of the yaw [rad]"
    )
    parser.add_argument("--boom", type=float, help="length of the boom [m]")
    parser.add_argument("--rise", type=float, default=0.03, help="smallest rise of a hop [m]")
    parser.add_argument("--window", type=float, default=0.04, help="half the time over which an apex is fitted [s]")
    parser.add_argument("--plan", help="CSV file with a row for each hop")
    parser.add_argument("--plan-columns", help="its columns to copy; launch speed, angle, ground height for --gravity")
    parser.add_argument("--gravity", type=float, help="predict apexes of ballistic flight with this gravity [m/s²]")
    parser.add_argument("--launch-height", type=float, default=0.0, help="height above the ground at take-off [m]")
    names, steps = steps_of(parser.parse_args(arguments))
    print(",".join(names))
    for step in steps.tolist():
        print(",".join(f"{number:.6g}" for number in step))


if __name__ == "__main__":
    if sys.argv[1:]:
        main(sys.argv[1:])
    else:
        with TemporaryDirectory() as folder:
            main(demonstrate(Path(folder)))

"""Reading of a sweep from its TOML file, with errors that name the key and what would be right."""

from collections.abc import Iterator, Mapping, Sequence
from math import prod
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from stepgap.base.errors import InputError
from stepgap.base.random_streams import random_stream
from stepgap.base.ranges import format_value
from stepgap.base.settings_file import check_keys, inner_table, read_toml
from stepgap.experiment.inputs import load_reference
from stepgap.experiment.settings import (
    ROBOT,
    Experiment,
    experiment_table,
    in_folder,
    merged_experiment,
    names_file,
    read_experiment,
)
from stepgap.robots.entry_points import simulations_of
from stepgap.sweep.sweep import KEEP, POINTS_SHA256, SEED, TWIN_NUMBER, Axis, Sweep, points_digest, with_changes

MOST_CASES = 10**6  # Largest number of cases of a sweep
LARGEST_END = 1e300  # Largest end of a range

_KEYS = ("base", "seeds", "twins", "keep", "axes", "sobol", POINTS_SHA256)


def read_sweep(path: Path) -> Sweep:
    """Reads a sweep from its file, or the sweep of a folder from the file in it.

    Raises:
        InputError: The file is wrong; the message names the file, the key and what would be right.
    """
    table = read_toml(path, "a sweep")
    check_keys(table, _KEYS, f"{path}: ")
    file = _base_file(table["base"], path) if "base" in table else None
    base = read_experiment(file, recorded=POINTS_SHA256 in table)
    if not base.simulated:
        plants = ", ".join(simulations_of(base.robot))
        raise InputError(f"{path}: base: plant '{base.plant}' is not simulated; a sweep needs one of {plants}")
    keep: Any = table.get("keep", KEEP[0])
    if keep not in KEEP:
        raise InputError(f"{path}: keep = {format_value(keep)}, but it must be one of {', '.join(KEEP)}")
    entries = _flat(inner_table(table, "axes", f"{path}: "))
    values = {name: _absolute(base, name, value, path.parent) for name, value in entries}
    table = {"seeds": [base.seed], **table, "keep": keep, "axes": values}
    axes = (
        *_twins(table, path),
        *_sobol(table, path),
        *_axes(base, values, path),
        Axis((SEED,), tuple((seed,) for seed in _integers(table["seeds"], f"{path}: seeds"))),
    )
    load_reference(base, base.space)  # a missing file is reported now, not in every case
    _check(base, axes, path)
    if table.pop(POINTS_SHA256, None) not in (None, points_digest(base, axes)):
        wanted = "use the versions and files that made it, or remove this key for a new sweep"
        raise InputError(f"{path}: {POINTS_SHA256}: the axes do not have these points; {wanted}")
    return Sweep(base, axes, table, keep)


def _absolute(base: Experiment, name: str, value: Any, folder: Path) -> Any:
    """The values of an axis, with absolute paths."""
    if not names_file(base.robot, name) or not isinstance(value, list):
        return value
    home = folder.resolve()
    robot = base.robot
    return [in_folder(home, robot, name, file) if isinstance(file, str) else file for file in value]


def _check(base: Experiment, axes: Sequence[Axis], path: Path) -> None:
    """Raises InputError if a setting is on two axes, a value is not valid, or there are too many cases."""
    names = [name for axis in axes for name in axis.names]
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"{path}: {name} is on two axes; it must be on one")
        if any(other.startswith(f"{name}.") for other in names):
            raise InputError(f"{path}: {name} is a table and on two axes; give its keys, such as {name}.KEY")
    count = prod(len(axis.points) for axis in axes)
    if count > MOST_CASES:
        raise InputError(f"{path}: these axes have {count} combinations, but there must be at most {MOST_CASES}")
    for axis in axes:
        for name, values in zip(axis.names, zip(*axis.points, strict=True), strict=True):
            numbers = all(type(value) is float for value in values)
            for value in {min(values), max(values)} if numbers else values:  # the valid ones are an interval
                _check_value(base, name, value, path)


def _check_value(base: Experiment, name: str, value: Any, path: Path) -> None:
    """Raises InputError if a value of a setting is not valid; numbers of twins and seeds were checked before."""
    plants = simulations_of(base.robot)
    if name == "plant" and value not in plants:
        raise InputError(f"{path}: plant = {format_value(value)}, but it must be one of {', '.join(plants)}")
    if name == "rig":
        raise InputError(f"{path}: rig: a sweep cannot use a rig; its plants are {', '.join(plants)}")
    if name == ROBOT:
        raise InputError(f"{path}: robot: a sweep has one robot; set it in the base experiment")
    if name not in (TWIN_NUMBER, SEED):
        merged_experiment(*with_changes(base, {name: value}), lambda key: f"{path}: [axes] {key}")


def _twins(table: Mapping[str, Any], path: Path) -> list[Axis]:
    if "twins" not in table:
        return []
    value = table["twins"]
    numbers = list(range(value)) if type(value) is int and 0 < value <= MOST_CASES else value
    wanted = "the number of random twins, such as 20, or a list of their numbers"
    return [Axis((TWIN_NUMBER,), tuple((number,) for number in _integers(numbers, f"{path}: twins", wanted)))]


def _axes(base: Experiment, table: Mapping[str, Any], path: Path) -> list[Axis]:
    axes = []
    for name, value in table.items():
        location = f"{path}: [axes] {name}"
        if name in (TWIN_NUMBER, SEED):
            raise InputError(f"{location}: give {name}s = […] at the top of the file instead")
        values = _evenly(value, location) if isinstance(value, Mapping) else value
        if isinstance(value, Mapping) and _is_integer(base, name):
            values = [int(number) if number.is_integer() else number for number in values]
        single = isinstance(values, list) and not any(isinstance(entry, Mapping | list) for entry in values)
        if not values or not single:
            wanted = "a list of values that is not empty, or a range such as { from = 0.5, to = 1, points = 6 }"
            raise InputError(f"{location} = {format_value(value)}, but it must be {wanted}")
        if len(set(values)) < len(values):
            raise InputError(f"{location} = {format_value(value)}, but its values must differ")
        axes.append(Axis((name,), tuple((number,) for number in values)))
    return axes


def _sobol(table: Mapping[str, Any], path: Path) -> list[Axis]:
    """The axis of a Sobol' sequence: scrambled points that cover the ranges of several settings evenly."""
    if "sobol" not in table:
        return []
    location = f"{path}: [sobol]"
    sobol = inner_table(table, "sobol", f"{path}: ")
    check_keys(sobol, ("points", "seed", "ranges"), f"{location} ")
    points = sobol.get("points")
    if type(points) is not int or not 1 <= points <= MOST_CASES or points & (points - 1):
        rule = f"a power of 2 up to {MOST_CASES}, such as 64, because only then is the sequence balanced"
        raise InputError(f"{location} points = {format_value(points)}, but it must be {rule}")
    (seed,) = _integers([sobol.get("seed", 0)], f"{location} seed")
    ranges = dict(_flat(inner_table(sobol, "ranges", f"{location} ")))
    if not ranges:
        remedy = 'give some, such as [sobol.ranges] "gap.torque_scale" = [0.6, 1.0]'
        raise InputError(f"{location} ranges: missing; {remedy}")
    from scipy.stats import qmc  # the import takes long

    fractions = qmc.Sobol(len(ranges), rng=random_stream(seed)).random(points)
    columns = [
        _range(value, f"{path}: [sobol.ranges] {name}").at(fractions[:, column])
        for column, (name, value) in enumerate(ranges.items())
    ]
    return [Axis(tuple(ranges), tuple(zip(*columns, strict=True)))]


class _Range(NamedTuple):
    """An interval of a setting, on a linear or a logarithmic scale."""

    lower: float
    upper: float
    logarithmic: bool

    def at(self, fractions: NDArray[np.float64]) -> list[float]:
        """Values at fractions of the interval, rounded to 12 digits."""
        if self.logarithmic:
            values = self.lower * (self.upper / self.lower) ** fractions
        else:
            values = self.lower + (self.upper - self.lower) * fractions
        return [float(f"{value:.12g}") for value in values]


def _evenly(value: Mapping[str, Any], location: str) -> list[float]:
    """Values at equal distances in a range, or with equal ratios if the scale is log."""
    points = value.get("points")
    if type(points) is not int or not 2 <= points <= MOST_CASES:
        rule = f"an integer from 2 to {MOST_CASES}"
        raise InputError(f"{location}: points = {format_value(points)}, but it must be {rule}")
    interval = _range({key: end for key, end in value.items() if key != "points"}, location)
    return interval.at(np.linspace(0, 1, points))


def _is_integer(base: Experiment, name: str) -> bool:
    """Whether the value of a setting, given by its dotted name, is an integer."""
    value: Any = experiment_table(base)
    for key in name.split("."):
        value = value.get(key) if isinstance(value, Mapping) else None
    return type(value) is int


def _range(value: Any, location: str) -> _Range:
    """The interval `[lower, upper]` or `{ from, to, scale }`."""
    pair = isinstance(value, list) and len(value) == 2
    table: Any = {"from": value[0], "to": value[1]} if pair else value
    wanted = 'a range such as [0.6, 1.0] or { from = 1e3, to = 1e5, scale = "log" }'
    if not isinstance(table, Mapping):
        raise InputError(f"{location} = {format_value(value)}, but it must be {wanted}")
    check_keys(table, ("from", "to", "scale"), f"{location} ")
    ends: list[Any] = [table.get(key) for key in ("from", "to")]
    numbers = [float(end) for end in ends if type(end) in (int, float) and abs(end) < LARGEST_END]
    if len(numbers) < 2 or not numbers[0] < numbers[1]:
        raise InputError(f"{location} = {format_value(value)}, but it must be {wanted}, the smaller number first")
    scale = table.get("scale", "linear")
    if scale not in ("linear", "log") or (scale == "log" and numbers[0] <= 0):
        rule = "it must be linear, or log for positive numbers"
        raise InputError(f"{location}: scale = {format_value(scale)}, but {rule}")
    return _Range(numbers[0], numbers[1], scale == "log")


def _flat(table: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Entries of nested tables by dotted name; a table with the keys of a range is a value."""
    for key, value in table.items():
        if isinstance(value, Mapping) and not {"from", "to"} & set(value):
            yield from _flat(value, f"{prefix}{key}.")
        else:
            yield prefix + key, value


def _base_file(value: Any, path: Path) -> Path:
    if not isinstance(value, str) or not (path.parent / value).is_file():
        wanted = "an existing file of settings, such as the experiment.toml of a run"
        without = "without base, the default experiment"
        raise InputError(f"{path}: base = {format_value(value)}, but it must be {wanted}; {without}")
    return path.parent / value


_NUMBERS = "a list of different integers from 0, such as [1, 2, 3]"


def _integers(values: Any, location: str, wanted: str = _NUMBERS) -> list[int]:
    """A list of different integers that are not negative."""
    fine = isinstance(values, list) and values and all(type(entry) is int and 0 <= entry < 2**63 for entry in values)
    if not fine or len(set(values)) < len(values):
        raise InputError(f"{location} = {format_value(values)}, but it must be {wanted}")
    return values

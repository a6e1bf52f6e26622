"""Which of several robots of one type is unlike the others, and in what.

The steps of each robot are compared with what the others would have done: the median of the next states that the
learned maps of all robots predict for the same state and command. What remains is fitted by least squares in the
command, about one middle for all robots:

    remaining error = offset + gains · (command − middle) + noise

Offset, gains and the standard deviation of the noise are the *traits* of a robot, three kinds of numbers for each state
coordinate. Each is compared with mean and standard deviation of the other R − 1 robots:

    t = (trait − mean) / (deviation √(1 + 1 / (R − 1))),    z: as improbable of N(0, 1) as t is of Student's t

with R − 2 degrees of freedom, so z means the same for few robots as for many.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final, Literal, NamedTuple, final

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri, stdtr

from stepgap.base.errors import InputError
from stepgap.gauss.linear_regression import fit_linear
from stepgap.learning.residual import HistoryInputs, Residual
from stepgap.records.text import decimal, in_scale, trimmed, unit_suffix, with_unit
from stepgap.report.html import bullets, paragraph, section, table
from stepgap.step import Array, StepMap, StepSpace

LARGEST_Z: Final = 3.5
"""Value of z from which on a robot is unlike the others; of ten robots that are alike, with fifteen traits, some robot
exceeds it by chance in 7 % of cases at most."""

LEAST_COMMON: Final = 20  # Number of steps of each robot from which its traits can be found

MOST_UNCERTAIN: Final = 2.0
"""A map knows a point if its standard deviation there is at most this [standard deviations of a step's noise]; where it
follows a drift of the robot, it is seldom less than one."""

LEAST_DRIVEN: Final = 0.05
"""A gain is a trait if the standard deviation of its command is larger than this for every robot [half ranges]."""

EXPLANATION: Final = (
    "The steps of each robot are compared with the median of what was learned of all, at the same state and command. "
    "The table has each robot's difference from the mean of the others, and in brackets z, that difference in standard "
    f"deviations, corrected for the number of robots; * marks |z| > {LARGEST_Z}."
)


@final
@dataclass(frozen=True, eq=False)
class Individual:
    """What was learned of one robot.

    Attributes:
        name: Its name.
        nominal: Its nominal map.
        residual: The learned error of that map.
    """

    name: str
    nominal: StepMap
    residual: Residual


class Trait(NamedTuple):
    """A number in which robots are compared.

    Attributes:
        kind: offset [units of the state], gain [those per unit of the command], or the logarithm of the noise's std.
        state: Number of the state coordinate.
        command: Number of the command of a gain; 0 otherwise.
    """

    kind: Literal["offset", "gain", "noise"]
    state: int
    command: int = 0


@final
@dataclass(frozen=True, eq=False)
class ComparedRobots:
    """The traits of R robots.

    Attributes:
        names: Names of the robots.
        space: Names, units and ranges.
        traits: The T traits.
        middle: Command about which gains are taken; shape (m,).
        values: Shape (R, T).
    """

    names: tuple[str, ...]
    space: StepSpace
    traits: tuple[Trait, ...]
    middle: Array
    values: Array

    @cached_property
    def difference(self) -> Array:
        """Each robot's trait minus the mean of the others; shape (R, T)."""
        return self.values - np.array([others.mean(axis=0) for others in self._others])

    @cached_property
    def z(self) -> Array:
        """The same in standard deviations of the others; NaN for two robots; shape (R, T)."""
        others = len(self.names) - 1
        if others < 2:
            return np.full_like(self.values, np.nan)
        deviation = np.array([traits.std(axis=0, ddof=1) for traits in self._others]) * np.sqrt(1 + 1 / others)
        t = self.difference / np.maximum(deviation, np.finfo(float).tiny)
        return -np.sign(t) * ndtri(np.maximum(stdtr(others - 1, -np.abs(t)), np.finfo(float).tiny))

    @property
    def unlike(self) -> NDArray[np.bool_]:
        """Which robots are unlike the others, and in which traits; shape (R, T)."""
        return np.abs(self.z) > LARGEST_Z

    @property
    def _others(self) -> list[Array]:
        """Traits of the robots other than each; (R − 1, T)."""
        return [np.delete(self.values, row, axis=0) for row in range(len(self.names))]


def compare_individuals(individuals: Sequence[Individual]) -> ComparedRobots:
    """Compares robots by the steps from which their residuals were learned.

    Args:
        individuals: At least two robots of one type.

    Raises:
        InputError: Their states or commands differ, one has too few steps, or they have none in common.
    """
    _check(individuals)
    space = individuals[0].nominal.space
    n = len(space.state)
    commands = list[Array]()
    errors = list[Array]()
    for one in individuals:
        points, ends = _steps_of(one)
        usual, common = _usual_step(individuals, points)
        if np.count_nonzero(common) < LEAST_COMMON:
            raise InputError(
                f"{one.name}: only {np.count_nonzero(common)} of its steps are at states and commands that the others "
                f"know; {LEAST_COMMON} are needed: let all robots track the same reference"
            )
        commands.append(points[common, n:])
        errors.append((ends - usual)[common])
    middle = np.median(np.vstack(commands), axis=0)
    smallest = np.min([command.std(axis=0) for command in commands], axis=0)
    driven = np.flatnonzero(smallest > LEAST_DRIVEN * space.command_scale)
    traits = [
        *(Trait("offset", row) for row in range(n)),
        *(Trait("gain", row, int(column)) for row in range(n) for column in driven),
        *(Trait("noise", row) for row in range(n)),
    ]
    pairs = zip(commands, errors, strict=True)
    values = [_trait_values(command[:, driven] - middle[driven], error) for command, error in pairs]
    return ComparedRobots(tuple(one.name for one in individuals), space, tuple(traits), middle, np.array(values))


def _check(individuals: Sequence[Individual]) -> None:
    first = individuals[0].nominal.space
    for one in individuals:
        space = one.nominal.space
        if (space.state_names, space.command_names) != (first.state_names, first.command_names):
            raise InputError(
                f"{one.name}: its state and command are {', '.join(space.names)}, those of {individuals[0].name} "
                f"{', '.join(first.names)}; only robots of one type can be compared"
            )
        if one.residual.kind == "none" or one.residual.history_inputs != HistoryInputs():
            raise InputError(
                f"{one.name}: residual '{one.residual.kind}' is no function of state and command that was learned; "
                "run with another learning.residual, and without forgetting or inputs of a touchdown"
            )


def _steps_of(individual: Individual) -> tuple[Array, Array]:
    """States and commands (N, n + m) and measured next states (N, n) of the steps that were learned from."""
    points = individual.residual.regressions[0].points
    n = len(individual.nominal.space.state)
    errors = np.stack([regression.values for regression in individual.residual.regressions], axis=1)
    return points, individual.nominal.evaluate(points[:, :n], points[:, n:]).next_state + errors


def _usual_step(individuals: Sequence[Individual], points: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Median next state (N, n) of the robots that know a point, and which points (N,) more than half of them know."""
    n = len(individuals[0].nominal.space.state)
    predicted = list[Array]()
    for one in individuals:
        mean = one.nominal.evaluate(points[:, :n], points[:, n:]).next_state + one.residual.mean(points)
        certain = one.residual.std(points) <= MOST_UNCERTAIN * one.residual.noise_std
        sure = np.all(certain & np.isfinite(mean), axis=1)
        predicted.append(np.where(sure[:, None], mean, np.nan))
    common = np.mean(np.isfinite(predicted)[:, :, 0], axis=0) > 0.5
    usual = np.full((len(points), n), np.nan)
    usual[common] = np.nanmedian(np.array(predicted)[:, common], axis=0)
    return usual, common


def _trait_values(commands: Array, errors: Array) -> Array:
    """Offsets, gains and logarithms of the noise of one robot, from commands about the middle (N, k); shape (T,)."""
    fit = fit_linear(np.column_stack([np.ones(len(commands)), commands]), errors)
    variance = np.sum(fit.residual**2, axis=0) / max(len(errors) - fit.rank, 1)
    log_noise = np.log(np.maximum(variance, np.finfo(float).tiny)) / 2
    return np.concatenate([fit.weights[0], fit.weights[1:].T.ravel(), log_noise])


def difference_sentences(comparison: ComparedRobots) -> list[str]:
    """Which robots are unlike the others, and in what; one sentence that none is, or can be named."""
    count = len(comparison.names)
    if count < 3:
        return ["2 robots are too few to say which one is unlike the others; 3 are needed"]
    unlike = [_sentence(comparison, int(row), int(column)) for row, column in np.argwhere(comparison.unlike)]
    largest = np.abs(comparison.z).max()
    return unlike or [f"no robot is unlike the others: the largest |z| is {largest:.1f}, and {LARGEST_Z} counts"]


def _sentence(comparison: ComparedRobots, row: int, column: int) -> str:
    trait = comparison.traits[column]
    state = comparison.space.state[trait.state]
    command = comparison.space.command[trait.command]
    difference = float(comparison.difference[row, column])
    size = decimal(abs(difference), 2)
    if trait.kind == "noise":
        what = f"scatters {decimal(float(np.exp(difference)), 2)} times as much as that of the others"
    elif trait.kind == "offset":
        comparative = "lower" if difference < 0 else "higher"
        where = _middle(comparison)
        what = f"is {size}{unit_suffix(state)} {comparative} than that of the others at {where}"
    else:
        comparative = "less" if difference < 0 else "more"
        unit = _per(state.unit, command.unit)
        amount = f"{size} {unit}" if unit else size
        what = f"grows by {amount} {comparative} with {command.name} than that of the others"
    return f"{comparison.names[row]}: its {state.name} {what} (z = {_signed(comparison.z[row, column], 1)})"


def differences_section(comparison: ComparedRobots) -> str:
    """HTML section of a page on these robots: sentences, and a table with a row for each trait."""
    rows = [
        [_trait_name(comparison, trait), *(_cell(comparison, row, column) for row in range(len(comparison.names)))]
        for column, trait in enumerate(comparison.traits)
    ]
    return section(
        "individuals",
        "What was learned of the robots",
        bullets(difference_sentences(comparison)),
        paragraph(f"{EXPLANATION} Offsets are those at {_middle(comparison)}."),
        table("", ["", *comparison.names], rows),
    )


def _trait_name(comparison: ComparedRobots, trait: Trait) -> str:
    state = comparison.space.state[trait.state]
    if trait.kind == "offset":
        return with_unit(state)
    if trait.kind == "noise":
        return f"logarithm of the noise of {state.name}"
    command = comparison.space.command[trait.command]
    unit = _per(state.unit, command.unit)
    return f"{state.name} by {command.name}{f' [{unit}]' if unit else ''}"


def _middle(comparison: ComparedRobots) -> str:
    pairs = zip(comparison.space.command, comparison.middle.tolist(), strict=True)
    return ", ".join(f"{one.name} {trimmed(in_scale(value, one, 2))}{unit_suffix(one)}" for one, value in pairs)


def _per(unit: str, command_unit: str) -> str:
    """Unit of a gain; none where both are the same, or one is unknown."""
    return "" if unit == command_unit or not (unit and command_unit) else f"{unit} per {command_unit}"


def _cell(comparison: ComparedRobots, row: int, column: int) -> str:
    """A difference, with decimals by the largest of its trait, and z."""
    largest = float(np.max(np.abs(comparison.difference[:, column]), initial=0.0))
    places = 1 - int(np.floor(np.log10(largest))) if largest > 0 else 3
    difference = _signed(comparison.difference[row, column], min(max(places, 0), 6))
    mark = " *" if comparison.unlike[row, column] else ""
    return f"{difference} ({_signed(comparison.z[row, column], 1)}){mark}"


def _signed(value: float, places: int) -> str:
    return f"{value:+.{places}f}".replace("-", "−") if np.isfinite(value) else "–"

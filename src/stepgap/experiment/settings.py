"""Settings of an experiment, read with strict checks from TOML and options, and methods: named sets of settings."""

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from math import inf, log
from operator import attrgetter
from pathlib import Path
from typing import Any, NamedTuple, TypeVar, cast

from stepgap.base.errors import InputError
from stepgap.base.plugins import one_of
from stepgap.base.random_streams import random_stream
from stepgap.base.ranges import format_value, require
from stepgap.base.settings_file import (
    IS_KEY,
    Locate,
    located,
    merge_all,
    parse_toml,
    read_toml_text,
    to_table,
    with_table,
)
from stepgap.control.settings import ControlSettings
from stepgap.learning.settings import GONE_SETTINGS, LearningSettings
from stepgap.plants.process.process_plant import Timeouts
from stepgap.records.missing import Missing
from stepgap.robots.entry_points import load_robot, robot_names, simulations_of
from stepgap.robots.robot import Robot
from stepgap.step import StepSpace

_Choice = TypeVar("_Choice")

ROBOT = "robot"  # Key of the robot's name
DEFAULT_ROBOT = "hopper"  # Name of the robot if no other is given

_PATHS = ("reference", "rig", "warm_start", "prior", "nominal.file")
"""Settings of every experiment that name a file or a folder."""

PRIOR_OF_ROBOT = "robot"
NO_PRIOR = "none"
"""Values of the setting `prior` that name no file: that which comes with the robot, and no prior."""

PROCESS = "process"  # The plant that is another program; all others but the simulated ones are names of rigs

FROM_TEMPLATE = "template"
FROM_LOG = "log"
"""Kinds of nominal map that every robot has, each with a file."""

LONGEST_NAME = 60  # Longest name of a run [characters]
LONGEST_NOTE = 500  # Longest note on a run [characters]

GAP = "gap"
RANDOM = "random:"
"""The table of random differences, and the beginning of its presets `random:NUMBER`."""

LARGEST_NOMINAL_FILE = 2**28  # Largest file of a nominal map that is read [bytes]

SHORT_OPTIONS = {
    "gap": "gap.preset",
    "iterations": "learning.iterations",
    "explore": "learning.exploration",
    "online": "learning.online",
    "warm-start": "warm_start",
}
"""Settings whose options have other names, by the option."""

INTEGRAL_GAIN = 0.5  # Part k of an error by which the method `integral` changes its correction
RLS_FORGETTING = 0.99  # Factor of the weight of a step's error after every further step, in the method `rls`


class Method(NamedTuple):
    """A method.

    Attributes:
        learning: Settings of learning.
        control: Settings of step control.
        linear: Whether the nominal map is linearised (`nominal.linear`).
    """

    learning: LearningSettings
    control: ControlSettings = ControlSettings()
    linear: bool = False


def forgetting_time(factor: float) -> float:
    """Number of steps in which a weight falls to 1/e, if every step multiplies it by a factor between 0 and 1."""
    return -1 / log(factor)


METHODS: Mapping[str, Method] = {
    "default": Method(LearningSettings()),
    "paper": Method(
        LearningSettings(residual="fitrgp", early_stop=False, drift=False),
        ControlSettings(cautious=False, viability=False, avoid_failures=False, horizon=1),
    ),
    "integral": Method(
        LearningSettings(
            residual="constant", online=True, forgetting_time=forgetting_time(1 - INTEGRAL_GAIN), drift=False
        )
    ),
    "rls": Method(
        LearningSettings(residual="linear", online=True, forgetting_time=forgetting_time(RLS_FORGETTING), drift=False),
        linear=True,
    ),
    "affine": Method(LearningSettings(residual="linear", drift=False), linear=True),
}
"""Values of `method`, which sets the tables `[learning]` and `[control]` and `nominal.linear` before single keys.

- `paper` is the method as published: MATLAB's `fitrgp`, Eq. 13 without further rules, four redeployments.
- `integral` adds a constant b to the nominal map, b ← b + k (actual − nominal − b) after every step: an integrator for
  each coordinate. b is the mean of the errors, in which an error counts less by the factor 1 − k after every step. So
  it is the residual `constant` with a forgetting time, updated online.
- `rls` is adaptive linear step-to-step dynamics next = A x + B u + c: A, B and c begin as those of the linearised
  nominal map, and are updated after every step by recursive least squares with exponential forgetting, in the sense of
  arXiv 2209.08458. It is the linearised map plus the residual `linear`, which is updated online. Its prior keeps its
  weight, so the estimate does not wind up where the steps do not excite it.
- `affine` is the same without forgetting and fitted between deployments: least squares with the linearised nominal map
  as the prior, inverted within the bounds of the command.
"""


@dataclass(frozen=True)
class SettingsFile:
    """Content of an `experiment.toml`, which may have settings that this version does not know.

    Attributes:
        text: Text of the file.
        table: Content of the file as a TOML table.
    """

    text: str
    table: Mapping[str, Any]


@dataclass(frozen=True)
class NominalSettings:
    """Which nominal map is corrected.

    Attributes:
        kind: One of the robot's maps, such as equations; template: a step and rough derivatives from `file`; log:
            fitted to the steps in `file`. Empty: the first one of the robot.
        file: A template (TOML), the steps of a log (a `steps.csv`), or the surrogate of a simulator as a run stores it,
            relative to the experiment's file.
        linear: Whether the map is linearised at the mean target of the reference. On a linear map no step fails, so
            `control.viability` finds nothing.
        surrogate: Whether a smooth surrogate is fitted to the map, because it is slow or rough, such as equations that
            SciPy integrates; a simulator always has one.
    """

    kind: str = ""
    file: str = ""
    linear: bool = False
    surrogate: bool = False


@dataclass(frozen=True)
class Experiment:
    """All settings of an experiment; the names are those of the TOML file.

    In the file, `robot` is the name of the robot, and the tables of the robot stand beside those of the experiment.

    Attributes:
        robot: Robot with its settings.
        seed: Random seed.
        name: What this run, or its robot, is called, such as a serial number: in its report, in comparisons, and in the
            passport of what is exported.
        note: A sentence on this run for its report and comparisons.
        reference: Name of a reference of the robot; a CSV file of targets, relative to the experiment's file; or one
            target for a number of steps, such as "speed=0.3,height=0.6,steps=50". Empty: the first one of the robot.
        plant: A simulated plant of the robot, `process` (another program), or the name of a rig. Empty: the first
            simulated one.
        rig: File that describes that rig, relative to the experiment's file.
        warm_start: Folder of a run whose steps are known before the first deployment, of many runs, which compete, or a
            `steps.csv`, relative to the experiment's file; `none` or empty: nothing is known.
        prior: Prior over robots that learning begins with: `robot`, that which comes with the robot, with the default
            residual and the default nominal map; `none`; or a file that `stepgap prior` wrote, or a folder of such
            files, which compete, relative to the experiment's file.
        weights: By the name of a state coordinate, how much its squared error [half ranges] counts against those of the
            others, instead of the weight that the robot gives it, such as `speed = 0.5`. 0: it is predicted, but not
            tracked.
        nominal: Nominal map.
        learning: Settings of learning.
        control: Settings of step control.
        process: Longest times to wait for the program of the plant `process`.
    """

    robot: Robot = field(default_factory=partial(load_robot, DEFAULT_ROBOT), metadata={IS_KEY: False})
    seed: int = 0
    name: str = ""
    note: str = ""
    reference: str = ""
    plant: str = ""
    rig: str = ""
    warm_start: str = ""
    prior: str = PRIOR_OF_ROBOT
    weights: Mapping[str, float] = field(default_factory=dict[str, float])
    nominal: NominalSettings = field(default_factory=NominalSettings)
    learning: LearningSettings = field(default_factory=LearningSettings)
    control: ControlSettings = field(default_factory=ControlSettings)
    process: Timeouts = field(default_factory=Timeouts)

    def __post_init__(self) -> None:
        require(0 <= self.seed < 2**63, "seed", self.seed, "lie between 0 and 2⁶³")
        for key, longest in (("name", LONGEST_NAME), ("note", LONGEST_NOTE)):
            text = getattr(self, key)
            fits = len(text) <= longest and text.isprintable()
            require(fits, key, text, f"have at most {longest} printable characters")
        object.__setattr__(self, "reference", self.reference or next(iter(self.robot.references())))
        if self.warm_start == NO_PRIOR:
            object.__setattr__(self, "warm_start", "")
        object.__setattr__(self, "plant", self.plant or next(iter(self.robot.simulations()), PROCESS))
        kind = self.nominal.kind or next(iter(self.robot.nominal_maps()), FROM_TEMPLATE)
        object.__setattr__(self, "nominal", replace(self.nominal, kind=kind))

    @cached_property
    def space(self) -> StepSpace:
        """Names, units and ranges of the robot, with the weights of the experiment.

        Raises:
            ValueError: A weight is wrong.
        """
        return weighted_space(self.robot.space, self.weights)

    @property
    def simulated(self) -> bool:
        """Whether the plant is simulated, so that a deployment can be repeated."""
        return self.plant in simulations_of(self.robot)


def weighted_space(space: StepSpace, weights: Mapping[str, float]) -> StepSpace:
    """The space with other weights of the named state coordinates.

    Raises:
        ValueError: A name is not one of the state, a weight is negative or not finite, or all are 0.
    """
    if not weights:
        return space
    names = ", ".join(space.state_names)
    for name, weight in weights.items():
        require(name in space.state_names, f"weights.{name}", weight, f"have the name of a state coordinate: {names}")
        require(0 <= weight < inf, f"weights.{name}", weight, "be a finite number from 0 on")
    state = tuple(replace(quantity, weight=weights.get(quantity.name, quantity.weight)) for quantity in space.state)
    tracked = any(quantity.weight for quantity in state)
    require(tracked, "weights", dict(weights), f"leave a weight above 0 of at least one of {names}")
    return replace(space, state=state)


def read_experiment(
    path: Path | None, overrides: Iterable[tuple[str, str]] = (), *, recorded: bool = False
) -> Experiment:
    """Reads the experiment of a file, with single settings overridden.

    Args:
        path: TOML file; None for the defaults.
        overrides: Dotted name, or name of a short option, and value as TOML, such as ("gains.stiffness", "2400").
        recorded: Whether a run wrote the file: what a former version wrote there and is `GONE_SETTINGS` is ignored.

    Raises:
        InputError: A setting is wrong; the message names file, key and rule.
    """
    overrides = list(overrides)
    chosen = dict(_parsed(overrides)).get(ROBOT)
    text, table = ("", {}) if path is None else read_toml_text(path, "an experiment")
    if path is not None and not text.strip():
        raise InputError(
            f"{path}: empty, as a file that was lost; for the defaults write a comment into it, or give none"
        )
    table = _without_gone(table) if recorded else table

    def locate(name: str) -> str:
        return f"{path}: {with_table(name)}"

    named = (table.get(ROBOT, DEFAULT_ROBOT), locate(ROBOT)) if chosen is None else (chosen, f"--{ROBOT}")
    experiment = Experiment(_robot(*named))
    if chosen is not None and table.get(ROBOT, chosen) != chosen:
        raise InputError(f"--{ROBOT} {chosen}: {path} is an experiment of robot = {format_value(table[ROBOT])}")
    if path is not None:
        experiment = with_absolute_paths(changed_experiment(experiment, table, locate), path.parent)
    return with_settings(experiment, overrides)


def with_settings(experiment: Experiment, overrides: Iterable[tuple[str, str]]) -> Experiment:
    """The experiment with single settings other than its robot; `overrides` and errors as of `read_experiment`."""
    changes = nested((name, value) for name, value in _parsed(overrides) if name != ROBOT)
    options = {setting: option for option, setting in SHORT_OPTIONS.items()}
    return changed_experiment(experiment, changes, lambda name: f"--{options.get(name, name)}")


def _parsed(overrides: Iterable[tuple[str, str]]) -> list[tuple[str, Any]]:
    """Dotted names of settings, and their values."""
    return [(SHORT_OPTIONS.get(name, name).replace("-", "_"), _parse_value(value)) for name, value in overrides]


def read_settings_file(path: Path) -> SettingsFile | Missing:
    """Reads an `experiment.toml` as it is.

    Raises:
        InputError: It is not a TOML file.
    """
    if not path.exists():
        return Missing(f"the folder contains no {path.name}")
    if not path.is_file():
        raise InputError(f"{path}: not a file; it must be a text file that the run wrote")
    return SettingsFile(*read_toml_text(path, "the file that the run wrote"))


def with_absolute_paths(experiment: Experiment, folder: Path) -> Experiment:
    """The experiment from a file in this folder, to which its paths are relative."""
    written = {name: attrgetter(name)(experiment) for name in _PATHS}
    absolute = {name: in_folder(folder, experiment.robot, name, value) for name, value in written.items()}
    nominal = replace(experiment.nominal, file=absolute.pop("nominal.file"))
    robot = with_files(experiment.robot, lambda name, value: in_folder(folder, experiment.robot, name, value))
    return replace(experiment, **absolute, nominal=nominal, robot=robot)


def with_files(robot: Robot, change: Callable[[str, str], str]) -> Robot:
    """The robot with other names of its files: `change` is called with each key and value that is given."""
    for name in robot.files:
        table, key = name.split(".")
        part = getattr(robot, table)
        if value := getattr(part, key):
            robot = replace(cast("Any", robot), **{table: replace(part, **{key: change(name, value)})})
    return robot


def names_file(robot: Robot, name: str) -> bool:
    """Whether a setting of an experiment with this robot names a file or a folder."""
    return name in _PATHS or name in robot.files


def in_folder(folder: Path, robot: Robot, name: str, value: str) -> str:
    """The value of a setting that names a file and is given in a file of this folder, to which paths are relative."""
    words = {"reference": robot.references(), "prior": (PRIOR_OF_ROBOT, NO_PRIOR), "warm_start": (NO_PRIOR,)}
    constant = name == "reference" and is_constant_target(value)
    named = bool(value) and not constant and value not in words.get(name, ())
    return str(folder / value) if named else value


def is_constant_target(reference: str) -> bool:
    """Whether a reference is one target, such as `speed=0.3,steps=50`, instead of a name or a file."""
    return bool(_CONSTANT.fullmatch(reference)) and not reference.endswith(".csv")


_CONSTANT = re.compile(r"\w+=[^/=,]*(,\w+=[^/=,]*)*")


def experiment_table(experiment: Experiment) -> dict[str, Any]:
    """The experiment as the table of its TOML file."""
    return {ROBOT: experiment.robot.name, **to_table(experiment), **to_table(experiment.robot)}


def _parse_value(text: str) -> Any:
    """The TOML value that `text` represents; a word without quotes is a string."""
    try:
        table = parse_toml(f"value = {text}")
    except ValueError:
        return text
    return table["value"] if len(table) == 1 else text


def nested(entries: Iterable[tuple[str, Any]]) -> dict[str, Any]:
    """The nested tables of entries with dotted names."""
    tables: dict[str, Any] = {}
    for name, value in entries:
        *outer, last = name.split(".")
        table = tables
        for key in outer:
            inner = table.get(key)
            table[key] = inner if isinstance(inner, dict) else {}
            table = table[key]
        table[last] = value
    return tables


def changed_experiment(experiment: Experiment, table: Mapping[str, Any], locate: Locate) -> Experiment:
    """The experiment with the values of a TOML table.

    Raises:
        InputError: A setting is wrong, or settings do not fit together; messages name a key by `locate`.
    """
    experiment = merged_experiment(experiment, table, locate)
    try:
        experiment.robot.check()
    except ValueError as error:
        raise located(error, locate, "") from None
    if experiment.learning.exploration and experiment.space.adds_up.any():
        raise InputError(
            f"{locate('learning.exploration')} = {experiment.learning.exploration}, but distances add up from step 1 "
            "on, and exploratory steps before it have none; set it to 0"
        )
    if experiment.control.table and (experiment.learning.drift or experiment.learning.online):
        raise InputError(
            f"{locate('control.table')} = {experiment.control.table}, but a table does not change during a deployment; "
            "also set learning.drift = false and learning.online = false, as --method paper does"
        )
    return experiment


def merged_experiment(experiment: Experiment, table: Mapping[str, Any], locate: Locate) -> Experiment:
    """As `changed_experiment`, but without the check whether settings of different tables fit together."""
    for name in _gone(table):
        raise InputError(f"{locate(name)}: {GONE_SETTINGS[name]}")
    rest = dict(table)
    if ROBOT in rest:
        robot = _robot(rest.pop(ROBOT), locate(ROBOT))
        if type(robot) is not type(experiment.robot):
            experiment = Experiment(robot, experiment.seed)
    if "method" in rest:
        learning, control, linear = _chosen(METHODS, rest.pop("method"), locate("method"))
        nominal = replace(experiment.nominal, linear=linear)
        experiment = replace(experiment, learning=learning, control=control, nominal=nominal)
    robot = experiment.robot
    rest = _without_former(robot, rest, locate)
    for name in preset_names(robot):
        part = rest.get(name)
        if isinstance(part, Mapping) and "preset" in part:
            robot = _with_preset(robot, name, part["preset"], locate(f"{name}.preset"))
            rest[name] = {key: value for key, value in part.items() if key != "preset"}
    more = (ROBOT, "method", *(f"{name}.preset" for name in preset_names(robot)))
    experiment, robot = merge_all((experiment, robot), rest, locate, more=more)
    built_in = robot.references()
    reference = experiment.reference
    if "reference" not in table and reference in experiment.robot.references() and reference not in built_in:
        reference = next(iter(built_in))
    experiment = replace(experiment, robot=robot, reference=reference)
    try:
        _ = experiment.weights and experiment.space
    except ValueError as error:
        raise located(error, locate, "") from None
    return experiment


def preset_names(robot: Robot) -> Mapping[str, Sequence[str]]:
    """Names of the presets of the tables of a robot; those of random robots are `random:NUMBER`."""
    names = {table: list(presets) for table, presets in robot.presets.items()}
    if type(robot).randomised is not Robot.randomised:
        names[GAP] = [*names.get(GAP, []), f"{RANDOM}NUMBER"]
    return names


def _with_preset(robot: Robot, table: str, name: Any, where: str) -> Robot:
    """The robot with a preset of one of its tables; `where` names the setting in messages."""
    names = preset_names(robot)[table]
    number = name.removeprefix(RANDOM) if isinstance(name, str) else ""
    if f"{RANDOM}NUMBER" in names and name == f"{RANDOM}{number}" and number.isdecimal() and len(number) < 19:
        drawn = robot.randomised(random_stream(int(number)))
        if drawn is None:
            raise InputError(f"{where} = {format_value(name)}: robot '{robot.name}' has no random differences")
        return drawn
    presets = robot.presets.get(table, {})
    if name in list(presets):
        return replace(cast("Any", robot), **{table: presets[name]})
    raise InputError(f"{where} = {format_value(name)}, but it must be {one_of(name, names)}")


def _gone(table: Mapping[str, Any]) -> list[str]:
    tables = {key: part for key, part in table.items() if isinstance(part, Mapping)}
    return [name for key, part in tables.items() for inner in part if (name := f"{key}.{inner}") in GONE_SETTINGS]


def _without_gone(table: Mapping[str, Any]) -> dict[str, Any]:
    kept = dict(table)
    for name in _gone(table):
        key, _, gone = name.partition(".")
        kept[key] = {inner: value for inner, value in kept[key].items() if inner != gone}
    return kept


def _without_former(robot: Robot, table: Mapping[str, Any], locate: Locate) -> dict[str, Any]:
    """The table without the former settings of a robot; raises InputError where one has a value that had an effect."""
    kept = dict(table)
    for name, harmless in robot.former.items():
        key, _, former = name.partition(".")
        part = kept.get(key)
        if not isinstance(part, Mapping) or former not in part:
            continue
        if harmless is not None and part[former] != harmless:
            raise InputError(
                f"{locate(name)} = {format_value(part[former])}, but this setting is gone, and is read only as "
                f"{format_value(harmless)}; leave it out"
            )
        kept[key] = {inner: value for inner, value in part.items() if inner != former}
    return kept


def _robot(name: Any, where: str) -> Robot:
    """The robot of this name; `where` names the setting in messages."""
    if isinstance(name, Mapping):
        names = f"{ROBOT} = '{DEFAULT_ROBOT}' names the robot"
        raise InputError(f"{where}: this table is called [parameters] now; {names}")
    if not isinstance(name, str):
        raise InputError(f"{where} = {format_value(name)}, but it must be one of {', '.join(robot_names())}")
    return load_robot(name)


def _chosen(choices: Mapping[str, _Choice], name: Any, where: str) -> _Choice:
    """The choice of this name; `where` names the setting in the message of the InputError if there is none."""
    if name in list(choices):
        return choices[name]
    raise InputError(f"{where} = {format_value(name)}, but it must be {one_of(name, choices)}")

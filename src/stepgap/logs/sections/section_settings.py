"""Where the steps of a log begin and end, and what its columns mean."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, final

from stepgap.base.names import as_name
from stepgap.base.settings_file import merge, read_toml
from stepgap.logs.columns import check_units
from stepgap.logs.tables.log_table import LARGEST_VALUE
from stepgap.logs.tables.text import AS_FOUND, TextFormat
from stepgap.records.steps_csv import MOST_COORDINATES

RULES = ("phase", "contact", "force", "crossing", "every")
"""Keys of which at most one is given: how sections are found. Without them they are the tops of `height`."""

COORDINATES = ("state", "command", "target", "predicted")
"""Keys that name coordinates; `SignalCoordinate.of` reads their entries."""

NEXT_FOOT = "next_foot"  # Section of walking: another foot touches down than before
BOOM_COLUMNS = ("height", "forward")  # Columns that are computed from the angles of a boom
POSE_COLUMNS = ("forward", "left", "turn")  # Columns that are computed from a pose


@final
@dataclass(frozen=True)
class SectionSettings:
    """Sections of a log and the meaning of its columns.

    A coordinate is given by its column; as NAME=COLUMN to call it NAME; as NAME=rate(COLUMN) for the rate of a column;
    or as NAME=mean(COLUMN) or NAME=mean(rate(COLUMN)) for the mean over the step that ends at the section.

    Attributes:
        state: Coordinates of the state, as speed=rate(COLUMN),height=COLUMN, or vx=mean(COLUMN) for the mean over the
            step before, also vx=mean(rate(COLUMN)).
        command: Coordinates of the command, columns of the plan or of the log.
        target: Coordinates of the target, likewise.
        predicted: Coordinates of the state that the nominal map predicts, likewise.
        time: Column of the time [s], also of the messages of others in the log. [default: time, log_time, t, timestamp]
        height: Column of the height. Without the next four options, each of its tops is a section.
        phase: Column of the phase of gait, as text or numbers.
        contact: Columns that are 1 where a foot is in contact; flight is where all feet are in the air.
        force: Columns of the force between foot and ground, positive in contact; flight as for contact.
        crossing: Column that passes a level at the section, such as the position of the hip over the foot.
        every: Time from section to section [s], for commands that hold, such as of velocities: a step begins where the
            command changes, and then at these intervals for as long as it holds.
        hold: How long a command holds if no other one follows [s]. [default: five usual times between two of them]
        aerial: Phases in which the robot is in the air. [default: those with flight, aerial or swing in their names]
        at: Section of a flight: apex, begin (lift-off) or end (touch-down); of walking, next_foot, which is the
            touch-down of another foot than before. [default: apex]
        threshold: Force above which a foot is in contact; it is in the air below a third of it. [default: 0.3 and 0.1
            of the 95th percentile]
        level: Level of the crossing. [default: 0]
        falling: The crossing is downwards.
        rise: Smallest prominence of a top of the height. [default: found]
        window: Time before and after a section from which the state is estimated [s]. [default: found]
        boom: Length [m] of the boom around which the robot hops: adds columns height = boom · sin(pitch) and forward =
            boom · yaw [m] to the log.
        pitch: Column of the boom's angle above the horizon [rad].
        yaw: Column of the boom's angle about the vertical [rad].
        pose: Columns x,y,yaw or x,y,qx,qy,qz,qw, or a message with a pose, such as pose.pose: adds columns forward,
            left [m] and turn [rad], the motion as the robot sees it.
        plan_time: Column of the time in the plan. [default: as --time]
        plan_match: PLAN_COLUMN=COLUMN, for a plan without times: its row is of the time at which both are equal.
        of_several: The command that counts if a step has several, for each coordinate. [default: such a step is left
            out]
        delay: Time that is added to those of commands, targets and predictions [s], where two clocks differ.
        deployment: Column that separates deployments, such as an episode: each is a log of its own.
        units: Units of columns, after multiplication by their factors.
        factors: Factors by which columns are multiplied.
        format: How the numbers of text files are written.
    """

    state: tuple[str, ...] = ()
    command: tuple[str, ...] = ()
    target: tuple[str, ...] = ()
    predicted: tuple[str, ...] = ()
    time: str = ""
    height: str = ""
    phase: str = ""
    contact: tuple[str, ...] = ()
    force: tuple[str, ...] = ()
    crossing: str = ""
    every: float = 0.0
    hold: float = 0.0
    aerial: tuple[str, ...] = ()
    at: Literal["apex", "begin", "end", "next_foot"] = "apex"
    threshold: float = 0.0
    level: float = 0.0
    falling: bool = False
    rise: float = 0.0
    window: float = 0.0
    boom: float = 0.0
    pitch: str = ""
    yaw: str = ""
    pose: tuple[str, ...] = ()
    plan_time: str = ""
    plan_match: str = ""
    of_several: Literal["first", "last", "largest"] | None = None
    delay: float = 0.0
    deployment: str = ""
    units: Mapping[str, str] = field(default_factory=dict)
    factors: Mapping[str, float] = field(default_factory=dict)
    format: TextFormat = AS_FOUND

    def __post_init__(self) -> None:
        rules = [name for name in RULES if getattr(self, name)]
        if len(rules) > 1:
            given = _joined(getattr(self, rules[1]))
            raise ValueError(f"{rules[1]} = {given!r:.60}, but it must not be given beside {rules[0]}")
        if self.at not in ("apex", "begin", "end", NEXT_FOOT):
            raise ValueError(f"at = {self.at!r:.40}, but it must be apex, begin, end or {NEXT_FOOT}")
        if self.at == NEXT_FOOT and len(self.contact or self.force) < 2:
            raise ValueError(
                f"at = {NEXT_FOOT!r}, but it must be given with the contact or the force of at least two feet"
            )
        if self.of_several not in (None, "first", "last", "largest"):
            raise ValueError(f"of_several = {self.of_several!r:.40}, but it must be first, last or largest")
        for name in ("threshold", "rise", "window", "boom", "every", "hold"):
            if not 0 <= getattr(self, name) < LARGEST_VALUE:
                raise ValueError(f"{name} = {getattr(self, name)!r}, but it must be a positive number, or 0")
        if not abs(self.delay) < LARGEST_VALUE:
            raise ValueError(f"delay = {self.delay!r}, but it must be a number of seconds")
        if self.boom and not (self.pitch and self.yaw):
            raise ValueError(f"boom = {self.boom!r}, but it must be given together with pitch and yaw")
        if len(self.pose) not in (0, 1, 3, 6) or (self.pose and self.boom):
            raise ValueError(
                f"pose = {_joined(self.pose)!r:.80}, but it must be x,y,yaw or x,y,qx,qy,qz,qw or the name of a "
                "message with a pose, and not be given beside boom"
            )
        if self.every and self.at != "apex":
            raise ValueError(f"at = {self.at!r}, but it must not be given beside every")
        if self.hold and not self.every:
            raise ValueError(f"hold = {self.hold!r}, but it must be given together with every")
        if self.at_apex and not self.height_column:
            raise ValueError("height = '', but it must be the column of the height, or a boom's pitch, for an apex")
        if not self.state:
            raise ValueError("state = '', but it must name the state, such as speed=rate(x),height=y")
        if self.plan_match and "=" not in self.plan_match:
            raise ValueError(f"plan_match = {self.plan_match!r:.60}, but it must be PLAN_COLUMN=COLUMN")
        self._check_coordinates()
        check_units(self.units, self.factors)

    def _check_coordinates(self) -> None:
        for role in COORDINATES:
            coordinates = self.coordinates(role)
            names = {coordinate.name for coordinate in coordinates}
            if len(names) < len(coordinates) or len(coordinates) > MOST_COORDINATES:
                raise ValueError(
                    f"{role} = {_joined(getattr(self, role))!r:.80}, but it must be at most {MOST_COORDINATES} "
                    "coordinates with different names"
                )
            if role in ("target", "predicted") and len(coordinates) not in (0, len(self.state)):
                given = _joined(getattr(self, role))
                raise ValueError(f"{role} = {given!r:.80}, but it must be {len(self.state)} coordinates, as the state")

    @property
    def at_apex(self) -> bool:
        """Whether sections are tops of the height."""
        return self.at == "apex" and self.rule not in ("crossing", "every")

    @property
    def height_column(self) -> str:
        """Column of the height; that of the boom if no other is given."""
        return self.height or (BOOM_COLUMNS[0] if self.boom else "")

    def coordinates(self, role: str) -> list["SignalCoordinate"]:
        """The coordinates of one of `COORDINATES`."""
        return [SignalCoordinate.of(entry) for entry in getattr(self, role)]

    @property
    def rule(self) -> str:
        """How sections are found: one of `RULES`, or "height"."""
        return next((name for name in RULES if getattr(self, name)), "height")


@final
@dataclass(frozen=True)
class SignalCoordinate:
    """A coordinate of a state or command.

    Attributes:
        name: Its name, an identifier.
        column: The column that it is computed from.
        rate: Whether it is the rate of this column.
        mean: Whether it is the mean over the step that ends at the section.
    """

    name: str
    column: str
    rate: bool
    mean: bool

    @staticmethod
    def of(entry: str) -> "SignalCoordinate":
        """Reads COLUMN or NAME=COLUMN, where rate(COLUMN), mean(COLUMN) or mean(rate(COLUMN)) may be the column."""
        name, _, given = entry.rpartition("=")
        mean = re.fullmatch(r"mean\((.+)\)", given.strip())
        inner = mean[1].strip() if mean else given.strip()
        rate = re.fullmatch(r"rate\((.+)\)", inner)
        column = rate[1] if rate else inner
        return SignalCoordinate(as_name(name.strip() or column), column, rate is not None, mean is not None)


def read_section_settings(file: Path | None, options: Mapping[str, Any]) -> SectionSettings:
    """Reads the settings from a TOML file and from options, which override the file.

    Raises:
        InputError: An entry is wrong; the message names file and key, or option, and the rule.
    """
    table = read_toml(file, "a file of sections and columns") if file else {}
    given = {key: list(value) if isinstance(value, tuple) else value for key, value in options.items()}
    if any(key in RULES for key in given):
        table = {key: value for key, value in table.items() if key not in RULES}

    def locate(key: str) -> str:
        return f"--{key.replace('_', '-')}" if key in options or not file else f"{file}: {key}"

    # Keys are checked together, since some depend on others; the start has what is required.
    start = SectionSettings(height="height", state=("height",))
    return merge(start, {"height": "", "state": []} | table | given, locate)


def _joined(value: str | float | tuple[str, ...]) -> str:
    return ",".join(value) if isinstance(value, tuple) else str(value)

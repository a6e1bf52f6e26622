"""Uneven ground by place: table `[ground]` of a robot, and the treads that a simulation makes of it.

Its parts add up: stairs of random heights, ramps that rise and fall in turn, a smooth random field, a measured profile,
stones with gaps between them, and patches of another stiffness and friction. The ground repeats after a length, such as
a turn of a boom. The same seed gives the same ground.
"""

import warnings
from dataclasses import dataclass, fields
from math import isfinite, pi, sqrt
from pathlib import Path
from typing import NamedTuple

import numpy as np

from stepgap.base.errors import InputError, StepGapWarning
from stepgap.base.files import read_bounded_text
from stepgap.base.ranges import require
from stepgap.control.reference import parse_rows
from stepgap.step import Array, Quantity

LARGEST_SLOPE = 0.5  # Steepest ramp, rise over length

FINEST = 0.01
"""Length of the straight pieces of a random field [m], or a tenth of its wave length where that is shorter."""

FELT = 0.06
"""Length of ground that a foot feels as one slope [m]: the width of its sole, some 3 cm, by how much it slides in a
stance, up to 2 cm, and how well the place of a foothold is measured, 1 cm."""

SHORTEST = 0.02  # Shortest length of a tread, a ramp, a wave or a patch [m]

_ROUNDING = 1e-9  # Height of a riser that is none [m]

GAP_DEPTH = 0.5
"""Depth of the gaps between stones [m]: a leg that steps into one finds no ground, and the robot falls."""

RUN_UP = 0.3  # Length of ground without gaps before the first stone [m], on which a robot is put
LARGEST_PROFILE = 2**20  # Largest file of a profile that is read [bytes]
HIGHEST = 1.0  # Largest height of a profile, up or down [m]

_PROFILE = (Quantity("place", "m", 0.0, 10.0), Quantity("height", "m", -0.05, 0.05))
"""Columns of the file of a profile."""

_STRIDE = 0.3  # Distance of two footholds that limits expect [m]


class Treads(NamedTuple):
    """Straight pieces of a ground, one behind the other; between two of them there may be a riser.

    Attributes:
        start: Place at which each piece begins, ascending from 0 [m]; shape (k,).
        height: Height there [m]; shape (k,).
        slope: Rise over length in the piece; shape (k,).
        stiffness: Its stiffness as a part of that of the ground elsewhere; shape (k,).
        friction: Its coefficient of friction as a part of that of the ground elsewhere; shape (k,).
    """

    start: Array
    height: Array
    slope: Array
    stiffness: Array
    friction: Array

    def ends(self, length: float) -> Array:
        """Place at which each piece ends [m] on a ground of a length [m]; shape (k,)."""
        return np.append(self.start[1:], length)

    def at(self, place: float) -> int:
        """Number of the piece at a place [m] from 0 to below the length of the ground."""
        return int(np.searchsorted(self.start, place, "right")) - 1

    def height_at(self, place: float) -> float:
        """Height at such a place [m]."""
        piece = self.at(place)
        return float(self.height[piece]) + float(self.slope[piece]) * (place - float(self.start[piece]))


class _Pieces(NamedTuple):
    """Heights by place of one part of a ground, straight between the starts of its pieces; arrays of shape (k,)."""

    start: Array
    height: Array
    slope: Array

    def at(self, place: Array) -> tuple[Array, Array]:
        """Heights [m] and slopes at places, of which a piece has its start; shapes as `place`."""
        piece = np.searchsorted(self.start, place, "right") - 1
        return self.height[piece] + self.slope[piece] * (place - self.start[piece]), self.slope[piece]

    def integrated(self, place: Array) -> Array:
        """Integral of the height from the start of the first piece to places [m²], with nothing added at risers."""
        long = np.diff(self.start)
        before = np.append(0.0, np.cumsum(long * (self.height[:-1] + self.slope[:-1] * long / 2)))
        piece = np.searchsorted(self.start, place, "right") - 1
        along = place - self.start[piece]
        return before[piece] + along * (self.height[piece] + self.slope[piece] * along / 2)

    def felt(self, length: float) -> "_Pieces":
        """This part as a foot feels it: between risers, which stay, the mean height over w = `FELT`.

        With the integral C of the height without risers, the mean is (C(x + w/2) − C(x − w/2)) / w. It is computed
        every `FINEST` and at the risers, and straight between them.

        Args:
            length: Length after which the ground repeats [m], longer than w; the first piece starts at 0.
        """
        rise = self.slope * np.diff(self.start, append=length)
        smooth = self.height[0] + np.append(0.0, np.cumsum(rise))  # without risers, to the end of the last piece
        riser = np.append(0.0, self.height[1:] - self.height[:-1] - rise[:-1])
        riser[np.abs(riser) < _ROUNDING] = 0.0
        turns = np.array([[-1.0], [0.0], [1.0]])
        around = _Pieces(
            start=(self.start + turns * length).ravel(),
            height=(smooth[:-1] + turns * (smooth[-1] - smooth[0])).ravel(),
            slope=np.tile(self.slope, 3),
        )
        evenly = np.linspace(0, length, round(length / FINEST), endpoint=False)
        start = np.union1d(evenly, self.start[riser != 0])
        ends = np.append(start, length)
        mean = (around.integrated(ends + FELT / 2) - around.integrated(ends - FELT / 2)) / FELT
        raised = np.cumsum(riser)[np.searchsorted(self.start, start, "right") - 1]
        return _Pieces(start, mean[:-1] + raised, np.diff(mean) / np.diff(ends))


@dataclass(frozen=True)
class UnevenGround:
    """Uneven ground by place; flat by default.

    Attributes:
        stair_height: Largest height of a riser, up or down; their heights are drawn independently and uniformly [m].
        stair_length: Mean length of a tread [m]; each is between half and one and a half times as long.
        slope: Rise over length of ramps that rise and fall in turn.
        ramp_length: Length of a ramp [m].
        roughness: Standard deviation of a smooth random height [m].
        wave_length: Its shortest wave [m]; all longer ones that fit have the same amplitude. From less than 12 cm on,
            and ramps of less than 6 cm, the ground is what a foot feels of it, its mean height over 6 cm.
        profile: A measured profile: a CSV file of place and height [m], relative to the experiment's file. It is
            straight between its rows, two rows of one place are a riser, and its end leads to its beginning. Where rows
            are nearer than 6 cm, it is smoothed between risers to what a foot feels.
        stone_spacing: Mean distance of the middles of stones, between which a foot finds no ground [m]; 0: no stones.
            A deployment begins at the first one, at place 0.
        stone_spread: By how much each of these distances may be shorter or longer [m]; they are drawn independently
            and uniformly, and together fill the ground.
        stone_length: Length of a stone [m].
        stone_seed: Draws the stones, in place of the seed of the run, since the robot knows where they are.
        patch_stiffness: Stiffness of every other patch, as a part of that of the ground.
        patch_friction: Coefficient of friction of every other patch, as a part of that of the ground.
        patch_length: Length of a patch [m].
        footholds: Whether the place of the next touchdown is tracked instead of the speed, as it always is on stones.
        measured_heights: Whether a robot without a simulation, too, measures heights above the ground that its foot
            finds at touchdown, and chooses the command again there; on uneven ground it always does.
        inputs: Whether the slope and the yielding that a touchdown finds are inputs of the residual; `false` for a
            controller that will be exported.
    """

    stair_height: float = 0.0
    stair_length: float = 0.8
    slope: float = 0.0
    ramp_length: float = 1.5
    roughness: float = 0.0
    wave_length: float = 0.5
    profile: str = ""
    stone_spacing: float = 0.0
    stone_spread: float = 0.0
    stone_length: float = 0.08
    stone_seed: int = 0
    patch_stiffness: float = 1.0
    patch_friction: float = 1.0
    patch_length: float = 1.0
    footholds: bool = False
    measured_heights: bool = False
    inputs: bool = True

    def __post_init__(self) -> None:
        for entry in fields(self):
            value = getattr(self, entry.name)
            require(isinstance(value, str) or isfinite(value), entry.name, value, "be finite")
        for name in ("stair_height", "roughness", "stone_spacing", "stone_spread", "stone_seed"):
            require(getattr(self, name) >= 0, name, getattr(self, name), "not be negative")
        require(0 <= self.slope <= LARGEST_SLOPE, "slope", self.slope, f"lie between 0 and {LARGEST_SLOPE:g}")
        for name in ("stair_length", "ramp_length", "wave_length", "stone_length", "patch_length"):
            require(getattr(self, name) >= SHORTEST, name, getattr(self, name), f"be at least {SHORTEST:g} m")
        for name in ("patch_stiffness", "patch_friction"):
            require(getattr(self, name) > 0, name, getattr(self, name), "be positive")
        if self.stone_spacing:
            rule = f"be less than stone_spacing = {self.stone_spacing:g} by {SHORTEST:g} m at least"
            require(self.stone_spread <= self.stone_spacing - SHORTEST, "stone_spread", self.stone_spread, rule)

    @property
    def is_flat(self) -> bool:
        """Whether the ground is the same everywhere."""
        patches = self.patch_stiffness != 1 or self.patch_friction != 1
        return not (self.stair_height or self.slope or self.roughness or self.profile or self.stone_spacing or patches)

    @property
    def is_measured(self) -> bool:
        """Whether heights are those above the ground that was measured at touchdown."""
        return self.measured_heights or self.has_footholds or not self.is_flat

    @property
    def has_footholds(self) -> bool:
        """Whether the place of the next touchdown is tracked."""
        return self.footholds or self.stone_spacing > 0

    @property
    def largest_change(self) -> float:
        """Change of height from a foothold to the next [m] that limits should allow; three deviations at rough ones.

        Raises:
            InputError: The profile cannot be read.
        """
        profile = float(np.ptp(_rows_of(self.profile)[:, 1])) if self.profile else 0.0
        return self.stair_height + _STRIDE * self.slope + 6 * self.roughness + profile

    def treads(self, length: float, rng: np.random.Generator) -> Treads:
        """The pieces of a ground that repeats after a length [m].

        Args:
            rng: Draws the ground. Parts that are left out draw nothing.

        Raises:
            InputError: The profile cannot be read, or is longer than the ground.
        """
        parts = [_Pieces(np.zeros(1), np.zeros(1), np.zeros(1))]
        if self.stair_height:
            parts.append(self._stairs(length, rng))
        if self.roughness:
            field = self._field(length, rng)
            parts.append(field.felt(length) if self.wave_length < 2 * FELT else field)
        if self.slope:
            ramps = self._ramps(length)
            parts.append(ramps.felt(length) if self.ramp_length < FELT else ramps)
        if self.profile:
            parts.append(_profile(self.profile, length))
        if self.stone_spacing:
            parts.append(self._gaps(length))
        softer = self.patch_stiffness != 1 or self.patch_friction != 1
        patches = _evenly(length, self.patch_length) if softer else np.zeros(1)
        start = np.unique(np.concatenate([patches, *(part.start for part in parts)]))
        heights, slopes = zip(*(part.at(start) for part in parts), strict=True)
        odd = np.searchsorted(patches, start, "right") % 2 == 0
        return Treads(
            start=start,
            height=np.sum(heights, axis=0),
            slope=np.sum(slopes, axis=0),
            stiffness=np.where(odd, self.patch_stiffness, 1.0),
            friction=np.where(odd, self.patch_friction, 1.0),
        )

    def stones(self, length: float) -> Array:
        """Places of the middles of the stones on a ground that repeats after a length [m]; the first is 0."""
        rng = np.random.default_rng(self.stone_seed)
        count = max(2, round(length / self.stone_spacing))
        ends = np.cumsum(self.stone_spacing + self.stone_spread * rng.uniform(-1, 1, count))
        return np.append(0.0, ends[:-1]) * (length / ends[-1])

    def _gaps(self, length: float) -> _Pieces:
        """Gaps between the stones; there are none from `RUN_UP` before the first stone to the second one."""
        stones = self.stones(length)
        half = self.stone_length / 2
        begin = stones[1:] + half
        end = np.minimum(np.append(stones[2:] - half, length), length - RUN_UP)
        real = begin < end
        start = np.append(0.0, np.column_stack([begin[real], end[real]]))
        height = np.append(0.0, np.tile([-GAP_DEPTH, 0.0], np.count_nonzero(real)))
        return _Pieces(start, height, np.zeros(len(start)))

    def _stairs(self, length: float, rng: np.random.Generator) -> _Pieces:
        """Level treads."""
        count = max(2, round(length / self.stair_length))
        lengths = rng.uniform(0.5, 1.5, count)
        start = np.append(0.0, np.cumsum(lengths)[:-1]) * (length / lengths.sum())
        risers = rng.uniform(-self.stair_height, self.stair_height, count)
        risers -= risers.mean()  # after its length, the ground is as high as where it began
        heights = np.cumsum(risers * min(1.0, self.stair_height / np.abs(risers).max()))
        return _Pieces(start, heights - heights.mean(), np.zeros(count))

    def _field(self, length: float, rng: np.random.Generator) -> _Pieces:
        """A smooth random profile."""
        waves = np.arange(1, max(2, int(length / self.wave_length) + 1))
        place = np.linspace(0, length, max(16, round(length / min(FINEST, self.wave_length / 10))), endpoint=False)
        phases = rng.uniform(0, 2 * pi, len(waves))
        angles = 2 * pi * np.outer(place / length, waves) + phases
        return _closed(place, self.roughness * sqrt(2 / len(waves)) * np.sin(angles).sum(axis=1), length)

    def _ramps(self, length: float) -> _Pieces:
        """Ramps that rise and fall in turn."""
        start = _evenly(length, self.ramp_length)
        return _closed(start, self.slope * length / len(start) * np.where(np.arange(len(start)) % 2, 0.5, -0.5), length)


def _closed(place: Array, height: Array, length: float) -> _Pieces:
    """Straight pieces from each corner to the next; the last one leads to the first, a length [m] on."""
    return _Pieces(place, height, (np.roll(height, -1) - height) / np.diff(np.append(place, place[0] + length)))


def _rows_of(path: str) -> Array:
    """Places and heights of a profile [m], as its file has them; shape (k, 2).

    Raises:
        InputError: It cannot be read; the message names file, line and column.
    """
    try:
        rows = parse_rows(read_bounded_text(Path(path), LARGEST_PROFILE), _PROFILE, path, "row")
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}; ground.profile must be a CSV file of place and height") from None
    except UnicodeDecodeError:
        raise InputError(f"{path}: this is not text; a profile is a CSV file in UTF-8") from None
    except ValueError as error:
        raise InputError(str(error)) from None
    for row in np.flatnonzero(np.diff(rows[:, 0]) < 0):
        before, place = rows[row : row + 2, 0]
        raise InputError(f"{path}, row {row + 2}: place {place:g} m follows {before:g} m; places must not fall")
    for row in np.flatnonzero(np.abs(rows[:, 1]) > HIGHEST):
        raise InputError(f"{path}, row {row + 1}: height {rows[row, 1]:g} m; it must be within ±{HIGHEST:g} m")
    return rows


def _profile(path: str, length: float) -> _Pieces:
    """A measured profile of a ground with a length [m]; where rows are nearer than `FELT`, as a foot feels it.

    A `StepGapWarning` says so.

    Raises:
        InputError: It cannot be read, goes beyond the ground, or is steeper than a ramp.
    """
    place, height = _rows_of(path).T
    if place[0] < 0 or place[-1] >= length:
        wrong = place[0] if place[0] < 0 else place[-1]
        raise InputError(f"{path}: place {wrong:g} m is not on the ground; it must be from 0 to below {length:.4g} m")
    place = np.append(place, place[0] + length)
    height = np.append(height, height[0])
    long = np.diff(place)
    is_piece = long > 0  # two rows of one place are a riser
    start = place[:-1][is_piece]
    slope = np.diff(height)[is_piece] / long[is_piece]
    pieces = _from_zero(_Pieces(start, height[:-1][is_piece], slope), length)
    if long[is_piece].min() < FELT - _ROUNDING and np.ptp(slope) > 0:
        pieces = pieces.felt(length)
        warnings.warn(
            f"{path}: rows are {long[is_piece].min():g} m apart; a foot feels {FELT:g} m of ground as one slope, so "
            "between risers (two rows of one place) the profile is the mean over that length",
            StepGapWarning,
            stacklevel=2,
        )
    _check_slopes(path, place, height, pieces)
    return pieces


def _from_zero(pieces: _Pieces, length: float) -> _Pieces:
    """Pieces whose last one leads to the first one, with a start at 0."""
    start, height, slope = pieces
    if start[0] == 0:
        return pieces
    at_zero = height[-1] + slope[-1] * (length - start[-1])
    return _Pieces(np.append(0.0, start), np.append(at_zero, height), np.append(slope[-1], slope))


def _check_slopes(path: str, place: Array, height: Array, pieces: _Pieces) -> None:
    """Raises InputError if a profile with rows of these places and heights [m] is steeper than a ramp."""
    steep = np.flatnonzero(np.abs(pieces.slope) > LARGEST_SLOPE * (1 + _ROUNDING))
    if not len(steep):
        return
    start = pieces.start[steep[0]]
    row = max(int(np.searchsorted(place, start, "right")) - 1, 0)
    raise InputError(
        f"{path}, row {row + 1}: the ground rises by {height[row + 1] - height[row]:g} m within "
        f"{place[row + 1] - place[row]:g} m, a slope of {pieces.slope[steep[0]]:.2g}; it may be {LARGEST_SLOPE:g}, and "
        "a riser is two rows of one place"
    )


def _evenly(length: float, piece: float) -> Array:
    """Where equal pieces begin that fill a length; they are about as long as `piece`, and their number is even."""
    pairs = max(1, round(length / (2 * piece)))
    return np.linspace(0, length, 2 * pairs, endpoint=False)


FLAT_GROUND = UnevenGround()  # Ground that is the same everywhere

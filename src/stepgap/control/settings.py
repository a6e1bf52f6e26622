"""The user's settings of step control: which rules restrict the command of Eq. 13, and whether a table replaces it."""

from dataclasses import dataclass
from math import inf

from stepgap.base.ranges import require

MOST_MADE_UP = 1000  # Largest number of steps over which errors are made up for
LONGEST_HORIZON = 10  # Largest number of steps that are planned together


@dataclass(frozen=True)
class ControlSettings:
    """Settings of step control; each rule can be switched off. Without all three, Eq. 13 is solved as it is.

    Attributes:
        cautious: Whether the command has the least error² + (2 standard deviations)², where the corrected map is
            uncertain; otherwise its prediction is the target, however uncertain it is.
        viability: Whether the next state must permit a further step, also if it is off by two standard deviations.
        avoid_failures: Whether steps that resemble a failed one are not taken.
        evaluations: Largest number of steps that the maps evaluate for the choice of one command, half of them in the
            search, which then ends with the best command so far, and half in the checks of its commands; where states
            are not tracked, half as many more for the cost of later steps. A lower number bounds the time that a
            command takes on a slow nominal map. A Jacobian counts as its central differences.
        horizon: Number of steps whose commands are chosen together, with the targets that the reference has for them,
            where single steps do not reach them or states are not tracked: the robot begins early with a change that
            takes several steps. With 1, each command is chosen for its own step alone, as in the paper.
        largest_change: Largest change of each command from one step to the next, as a share of its range; 1 for no
            limit. The first command of a deployment has none. A later command of a horizon may lie as many changes
            away from the present one as there are steps between them.
        widening: How much farther a command may be from the state, such as a commanded velocity of a walking robot from
            its velocity, than in all deployments before that did not fall, as a share of the largest distance in these;
            inf for no limit. Elsewhere than where states are velocities in a plane, it says nothing.
        surprise: Root mean square error of the predictions of the last two steps [half ranges] above which the next
            command is the target itself, as of a commanded velocity: a robot that does not follow is not pushed on;
            inf for never. It says nothing before the first redeployment, nor elsewhere than where states are velocities
            in a plane.
        make_up: Number of steps over which the sum of all errors of a deployment is made up for, by targets that differ
            from those wanted by that much; 0 for not at all. Where states are velocities in a plane, such as of
            walking, that is a heading and a place, which are kept, as they are measured or by the sum of velocities.
        table: Points along each axis of a look-up table of commands that is computed before every deployment and used
            in place of solving (the paper, Sec. 6); 0 for none. Its prediction is interpolated, too. It covers the
            range of use of state and target: for a state outside, the command is that of the nearest state inside.
    """

    cautious: bool = True
    viability: bool = True
    avoid_failures: bool = True
    evaluations: int = 2000
    table: int = 0
    horizon: int = 2
    largest_change: float = 1.0
    widening: float = inf
    surprise: float = inf
    make_up: int = 0

    def __post_init__(self) -> None:
        require(self.evaluations >= 20, "evaluations", self.evaluations, "be at least 20")
        require(1 <= self.horizon <= LONGEST_HORIZON, "horizon", self.horizon, f"lie between 1 and {LONGEST_HORIZON}")
        require(0 <= self.make_up <= MOST_MADE_UP, "make_up", self.make_up, f"lie between 0 and {MOST_MADE_UP}")
        rule = "lie between 0.001 and 1, the whole range"
        require(0.001 <= self.largest_change <= 1, "largest_change", self.largest_change, rule)
        require(self.widening >= -0.9, "widening", self.widening, "be at least -0.9, or inf for no limit")
        require(self.table == 0 or 2 <= self.table <= 41, "table", self.table, "be 0, or lie between 2 and 41")
        require(self.surprise > 0, "surprise", self.surprise, "be a positive number of half ranges, or inf for never")
        limited = self.table > 0 and (self.largest_change < 1 or self.widening < inf)
        rule = "be 0 with a largest_change or a widening, because a table has one command for a state"
        require(not limited, "table", self.table, rule)


ALL_RULES = ControlSettings()  # The default: all rules, no table

"""What is to be known of a trained policy beside its network, as in `policy.toml`."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from math import inf
from pathlib import Path

from stepgap.base.ranges import require
from stepgap.base.settings_file import build_from_file


@dataclass(frozen=True)
class Scales:
    """Factors on the numbers of the observation, by their term: one for all numbers of the term, or one for each.

    Attributes:
        base_lin_vel: Velocity of the body in its own frame [m/s].
        base_ang_vel: Angular velocity of the body in its own frame [rad/s].
        projected_gravity: Direction of gravity in the frame of the body.
        joint_pos: Positions of the joints less their default positions [rad].
        joint_vel: Velocities of the joints [rad/s].
        actions: The actions before, all zero at the start.
        command: Commanded velocities forward [m/s], to the left [m/s], and of turning to the left [rad/s].
        phase_sin: Sines of the gait's phases.
        phase_cos: Cosines of the gait's phases.
    """

    base_lin_vel: tuple[float, ...] = (1.0,)
    base_ang_vel: tuple[float, ...] = (1.0,)
    projected_gravity: tuple[float, ...] = (1.0,)
    joint_pos: tuple[float, ...] = (1.0,)
    joint_vel: tuple[float, ...] = (1.0,)
    actions: tuple[float, ...] = (1.0,)
    command: tuple[float, ...] = (1.0,)
    phase_sin: tuple[float, ...] = (1.0,)
    phase_cos: tuple[float, ...] = (1.0,)


TERMS = tuple(entry.name for entry in fields(Scales))  # Names of the terms of which an observation can be made


@dataclass(frozen=True)
class PolicySettings:
    """A trained policy, its robot, and what lies between them.

    A joint's target is its default position plus its action times its scale; a position servo moves the joint there.

    Attributes:
        policy: The network: an ONNX file with one input, the observation, and one output, the actions. The path is
            relative to this file.
        model: The robot: a MuJoCo model (MJCF), whose first body has a free joint. The path is relative to this file.
        timestep: Time step of the simulation [s], as in the training.
        period: Time between two actions [s], as in the training.
        joints: Joints of the model in the order of the actions, and of the terms of the observation that have joints.
        default_joint_pos: Positions of these joints where all actions are zero; the robot starts with them [rad].
        action_scale: Factor on the actions: one number for all joints, or one for each [rad].
        action_clip: Largest size of an action; what is larger is clipped before it is used, and before it is observed.
        stiffness: Gains of the position servos of the joints [N·m/rad]: one number for all, or one for each. Without
            any, the actuators of the model are position servos already, and keep their gains.
        damping: Gains of the same servos by the velocity [N·m·s/rad].
        observation: Terms of the observation in their order.
        imu: Site of the model in whose frame the velocities and gravity are observed; empty: that of the first body.
        gait_period: Period of the gait's phases [s], for the terms `phase_sin` and `phase_cos`.
        gait_offsets: The phases at the start, as shares of a period; each term has one number for each.
        gait_stands_below: Size of a command, the root of its summed squares, below which the gait stands: its phases
            are `gait_standing`, while its clock goes on.
        gait_standing: The phases of a gait that stands, as shares of a period; without any, sines and cosines are 0.
        gait_quickening: How many more periods a second the clock has for each unit of the size of the command.
        gait_quickens_to: Size of a command from which on the clock becomes no faster.
        history: Number of the latest observations that the network is given: one number for all terms, or one for each.
            At the start, all are the first one.
        history_by_term: Whether the observations of one term follow each other, as in Isaac Lab, or those of one time.
        newest_first: Whether the latest observation comes first, instead of last.
        scale: Factors on the terms.
    """

    policy: str
    model: str
    timestep: float
    period: float
    joints: tuple[str, ...]
    default_joint_pos: tuple[float, ...]
    action_scale: tuple[float, ...]
    observation: tuple[str, ...]
    action_clip: float = inf
    stiffness: tuple[float, ...] = ()
    damping: tuple[float, ...] = ()
    imu: str = ""
    gait_period: float = 0.8
    gait_offsets: tuple[float, ...] = (0.0,)
    gait_stands_below: float = 0.0
    gait_standing: tuple[float, ...] = ()
    gait_quickening: float = 0.0
    gait_quickens_to: float = inf
    history: tuple[int, ...] = (1,)
    history_by_term: bool = True
    newest_first: bool = False
    scale: Scales = Scales()

    def __post_init__(self) -> None:
        require(0 < self.timestep <= 0.02, "timestep", self.timestep, "lie between 0 and 0.02")
        require(0 < self.period <= 1, "period", self.period, "be positive, and at most 1")
        ticks = self.period / self.timestep
        whole = round(ticks) >= 1 and abs(ticks - round(ticks)) < 1e-6 * ticks
        require(whole, "period", self.period, f"be a multiple of timestep = {self.timestep:g}")
        require(0 < self.gait_period < inf, "gait_period", self.gait_period, "be positive")
        require(self.gait_stands_below >= 0, "gait_stands_below", self.gait_stands_below, "not be negative")
        require(0 <= self.gait_quickening < inf, "gait_quickening", self.gait_quickening, "not be negative")
        require(self.gait_quickens_to > 0, "gait_quickens_to", self.gait_quickens_to, "be positive")
        require(self.action_clip > 0, "action_clip", self.action_clip, "be positive")
        joints = len(self.joints)
        terms = len(self.observation)
        require(0 < joints == len({*self.joints}), "joints", list(self.joints), "have different names, at least one")
        for term in self.observation:
            require(term in TERMS, "observation", term, f"be made of {', '.join(TERMS)}")
        require(bool(terms), "observation", [], "have at least one term")
        by_term = self.history_by_term or len({*self.history}) <= 1
        require(by_term, "history_by_term", False, "be true where terms have different histories")
        require(all(1 <= length <= 1000 for length in self.history), "history", [*self.history], "lie from 1 to 1000")
        _check_length("history", self.history, (1, terms))
        _check_length("gait_offsets", self.gait_offsets, range(1, 100))
        _check_length("gait_standing", self.gait_standing, (0, len(self.gait_offsets)))
        _check_length("default_joint_pos", self.default_joint_pos, (joints,))
        _check_length("action_scale", self.action_scale, (1, joints))
        for name in ("stiffness", "damping"):
            require(all(gain >= 0 for gain in getattr(self, name)), name, [*getattr(self, name)], "not be negative")
        _check_length("stiffness", self.stiffness, (0, 1, joints))
        _check_length("damping", self.damping, (1, joints) if self.stiffness else (0,))
        for term, size in self.sizes.items():
            _check_length(f"scale.{term}", getattr(self.scale, term), (1, size))

    @property
    def sizes(self) -> dict[str, int]:
        """Number of values of each term at one time."""
        joints = len(self.joints)
        phases = len(self.gait_offsets)
        sizes = {"joint_pos": joints, "joint_vel": joints, "actions": joints, "phase_sin": phases, "phase_cos": phases}
        return {term: sizes.get(term, 3) for term in TERMS}

    @property
    def histories(self) -> tuple[int, ...]:
        """Length of the history of each term of the observation."""
        return self.history if len(self.history) > 1 else self.history * len(self.observation)


def _check_length(key: str, values: tuple[float, ...], lengths: Sequence[int]) -> None:
    """Ensures that a list has one of these lengths, and finite numbers."""
    counts = " or ".join(map(str, sorted({*lengths})))
    require(len(values) in lengths, key, [*values], f"have {counts} numbers, not {len(values)}")
    require(all(-inf < value < inf for value in values), key, [*values], "have finite numbers")


def read_policy_settings(path: Path) -> PolicySettings:
    """Reads a `policy.toml`.

    Raises:
        InputError: It cannot be read, or a setting is missing or wrong; the message names file, key and rule.
    """
    return build_from_file(PolicySettings, path, "a policy")

"""Joint control (Sec. 4.1 of the paper) as a `TickControl`: state kept from tick to tick, compiled call for a tick."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from math import degrees, inf, nan, tau
from typing import Any

import numpy as np
from numba import typeof
from numba.core.compiler_lock import global_compiler_lock

from stepgap.base.compiled_record import Record, as_record, from_record
from stepgap.plants.tick_control import FinishedStep, Mode, Order, RobotControl, TickControl
from stepgap.plants.ticks.log_description import FieldMeaning
from stepgap.plants.ticks.tick_table import TickTable
from stepgap.rigs.rig import HEALTHY, Health, Reading, Rig, RigFault, Torques
from stepgap.robots.ground import FLAT_GROUND, UnevenGround
from stepgap.robots.hopper.model.dynamics import masses_of
from stepgap.robots.hopper.model.joint_control import joint_law
from stepgap.robots.hopper.model.leg import foot, four_bar, leg_of
from stepgap.robots.hopper.parameters import CommandBounds, Gains, RobotParameters
from stepgap.robots.hopper.tick.closures import resumed
from stepgap.robots.hopper.tick.drive_motion import Disobedience
from stepgap.robots.hopper.tick.hop_state import Apex, HopState, Landing, TickSettings
from stepgap.robots.hopper.tick.hop_tick import interrupted_hop, tick
from stepgap.robots.hopper.tick.limits import SafetyLimits
from stepgap.robots.hopper.tick.phases import Phase
from stepgap.robots.hopper.tick.safety import DISOBEYS, DOUBTS, JointMotion, Limited
from stepgap.robots.hopper.tick.sensors import HopperReading, HopperSensorModel, hopper_sensors
from stepgap.robots.hopper.tick.stage import Stage
from stepgap.robots.hopper.tick.tick_row import TICK_BITS, TICK_COLUMN, TICK_NAMES, TICK_UNITS
from stepgap.step import Array, StepSpace, StepStatus

NO_COMMAND = (nan, nan)  # Command of an order without a command

_SCALARS = (*[0.0] * 7, False, False, 0, False, 0, *[0.0] * 5)
"""Arguments of `tick` after the arrays, by which their types are known; integer counts are converted to floats."""


def _prepare(settings: Record, memory: Record, row: Array) -> None:
    """Compiles the tick for these arrays and calls it with copies, because no tick may wait for compilation.

    The first call of a compiled function takes a millisecond longer than the others.
    """
    wanted: Any = (
        (tick, (settings, memory.copy(), row.copy(), *_SCALARS)),
        (interrupted_hop, (settings, memory.copy(), 0.0, 0.0)),
    )
    with global_compiler_lock:  # another thread may create a controller at the same time
        for function, arguments in wanted:
            if not function.signatures:
                function.compile(tuple(map(typeof, arguments)))
                function.disable_compile()
            function(*arguments)


class HopControl(TickControl):
    """Control of the hopper tick by tick; a hop lasts from apex to apex, a command acts from mid-stance to take-off.

    Args:
        robot: Robot that the rig is assumed to be.
        ground: Whether heights are those above the ground that the foot finds at touchdown, and whether the state has
            the place of the next foothold.
    """

    def __init__(
        self,
        sensor_model: HopperSensorModel,
        robot: RobotParameters,
        gains: Gains,
        limits: SafetyLimits,
        ground: UnevenGround = FLAT_GROUND,
    ):
        law = joint_law(robot, gains)
        uneven = ground.is_measured
        self._uneven = uneven
        self._footholds = ground.has_footholds
        self._settings = as_record(TickSettings(sensor_model, masses_of(robot), law, limits=limits, uneven=int(uneven)))
        self._memory = as_record(HopState())
        self._row = np.zeros(len(TICK_UNITS))
        _prepare(self._settings, self._memory, self._row)

    def observe(self, reading: HopperReading) -> HopState:
        """State after a tick with this reading in which the motors stay limp."""
        self.tick(0.0, reading, Order(Mode.LIMP, 0.0, NO_COMMAND), (0.0, 0.0))
        return self.state

    @property
    def units(self) -> Mapping[str, str]:
        """Fields of a row of the tick log."""
        return TICK_UNITS

    @property
    def motors(self) -> int:
        """The two motors of the four-bar leg."""
        return 2

    @property
    def evidence(self) -> tuple[float, ...]:
        """Evidence of small faults of yaw and pitch; none after a doubt, when a person checks the sensor."""
        if int(self._memory["watch"]["stopped"][0]) & DOUBTS:
            return ()
        closures = self._memory["sensors"]["closures"][0]
        parts = (closures[name].item() for name in ("evidence", "fit", "fall"))
        return (*chain.from_iterable(parts), float(closures["crooked"]))

    def resume(self, evidence: Sequence[float]) -> None:
        """Continues with the evidence of the deployment before."""
        if evidence:
            self._memory["sensors"]["closures"] = as_record(resumed(evidence))

    @property
    def state(self) -> HopState:
        """State from which the next tick starts."""
        return from_record(HopState, self._memory)

    @property
    def motion(self) -> JointMotion:
        """Motion of leg and hip that the last tick measured."""
        return from_record(JointMotion, self._memory["motion"])

    @property
    def memory(self) -> tuple[Record, Record, Array]:
        """Records of `TickSettings` and `HopState`, and the log row of the last tick, as compiled code takes them."""
        return self._settings, self._memory, self._row

    def tick(
        self, time: float, reading: Reading, order: Order, applied: Torques, health: Health = HEALTHY, age: float = 0.0
    ) -> tuple[Torques, int]:
        """Computes one tick: torques that may be written [N·m], and flags."""
        mode, share, command = order
        return tick(
            self._settings, self._memory, self._row, time, age, *reading, *health, int(mode), share, *command, *applied
        )  # fmt: skip

    def row(self, applied: Torques) -> Sequence[float]:
        """The row of the last tick for the log."""
        row = self._row.tolist()
        row[TICK_COLUMN.applied_1], row[TICK_COLUMN.applied_2] = applied
        return row

    def finished_step(self) -> FinishedStep:
        """The hop that ended with the last tick."""
        apex = Apex(*self._memory["apex"][0].item())
        state = np.array([apex.speed, apex.height, apex.next_foothold][: 2 + self._footholds])
        lost = np.array([apex.lost_x, apex.lost_y])
        return FinishedStep(state, np.array([apex.force_x, apex.force_y]), lost, self._context(apex.yaw))

    def touchdown(self) -> tuple[float, ...]:
        """Ground of this touchdown, yielding of the stance before; the yaw is that of the apex, not known yet."""
        return self._context(nan)

    def _context(self, yaw: float) -> tuple[float, ...]:
        """Context of a hop that ended at a yaw [rad], in the order of its `StepSpace`."""
        landing = Landing(*self._memory["landing"][0].item())
        stood = landing.strongest > 0  # else it has just landed, and the ground may be like that of the stance before
        yielding = landing.deepest / landing.strongest if stood else landing.yielding
        return (yaw, landing.ground, landing.foothold, landing.slope, yielding) if self._uneven else (yaw,)

    def failed_step(self, applied: Torques | None) -> FinishedStep:
        """The hop that was interrupted after the last tick."""
        force_x, force_y, *lost = interrupted_hop(self._settings, self._memory, *(applied or (np.nan, np.nan)))
        context = self._context(nan) if self._uneven else ()
        return FinishedStep(np.full(2 + self._footholds, np.nan), np.array([force_x, force_y]), np.array(lost), context)

    @property
    def status(self) -> StepStatus:
        """OK while the robot hops, otherwise the reason why it does not."""
        return StepStatus(int(self._memory["hop"]["status"][0]))

    @property
    def stopped(self) -> str:
        """Reasons for which the safety function stopped the robot, as text."""
        stopped = Limited(int(self._memory["watch"]["stopped"][0]))
        names = ", ".join(reason.name.lower().replace("_", " ") for reason in stopped if reason.name)
        if stopped & DISOBEYS:
            return f"{names} ({self._disobedience()})"
        if Limited.JOINT_SPEED not in stopped:
            return names
        motion = self.motion
        stage = from_record(Stage, self._memory["stage"])
        speed = abs(motion.rate_1) + abs(motion.rate_2)
        return f"{names} ({speed:.1f} rad/s; at most {stage.joint_speed:.1f} in this stage)"

    def _disobedience(self) -> str:
        """What the motors were commanded when a drive was doubted, and what they did."""
        torques = from_record(Disobedience, self._memory["drives"]["doubted"])
        return (
            f"motor 1 was commanded {torques.sent_1:.1f} N·m and moved as by {torques.moved_1:.1f}, motor 2 "
            f"{torques.sent_2:.1f} and {torques.moved_2:.1f}: the drive gives another torque than it was commanded, or "
            "else an encoder or the contact force is wrong"
        )


@dataclass(frozen=True)
class HopperControl(RobotControl):
    """Control of the hopper, of which a plant makes a `HopControl` for its rig.

    Attributes:
        robot: Robot that the rig is assumed to be.
        gains: Gains of the joint controller.
        bounds: Range of the command.
        limits: Limits of the safety function; None for the rig's or, if it has none, those of a simulation.
        ground: Whether heights are those above the ground that the foot finds at touchdown.
    """

    robot: RobotParameters
    gains: Gains
    bounds: CommandBounds
    limits: SafetyLimits | None = None
    ground: UnevenGround = FLAT_GROUND

    @property
    def space(self) -> StepSpace:
        """State [speed, height], command [fx, fy]."""
        return self.bounds.space(self.ground)

    @property
    def units(self) -> Mapping[str, str]:
        """Fields of a row of the tick log."""
        return TICK_UNITS

    @property
    def consent_request(self) -> str:
        """What a person is asked before the robot hops."""
        return (
            "The robot must hang from its cord with its foot off the ground, and nobody may be within its reach. "
            "Hold the space bar: it takes its landing posture within half a second; then lower it to the ground. "
            "It lands when you release the key."
        )

    def meaning(self, rig: Rig) -> FieldMeaning:
        """Names of phases and reasons, and the ranges of what the safety function judges."""
        limits = self.limits_of(rig)
        torques = dict.fromkeys(("applied_1", "applied_2"), (-limits.torque, limits.torque))
        late = {"late": (-inf, (limits.late_ticks + 1) * rig.sensor_model.tick)}
        return FieldMeaning(TICK_NAMES, TICK_BITS, {**limits.ranges(), **torques, **late})

    def control(self, rig: Rig) -> HopControl:
        """Compiled control of a rig at the start of a deployment."""
        sensors = hopper_sensors(rig.sensor_model)
        return HopControl(sensors, self.robot, self.gains, self.limits_of(rig), self.ground)

    def limp_limits(self, rig: Rig) -> SafetyLimits:
        """Limits of a rig whose motors get no torque."""
        return self.limits_of(rig).limp()

    def step_ends(self, ticks: TickTable) -> np.ndarray:
        """Ticks in which the robot had just passed an apex."""
        phase = ticks["phase"]
        return np.flatnonzero((phase[:-1] == Phase.ASCENT) & (phase[1:] == Phase.DESCENT)) + 1

    def describe(self, rig: Rig, tick: Mapping[str, float]) -> dict[str, str]:
        """Description of a logged tick: pose, contact, torques and exceeded limits."""
        reading = HopperReading(*(tick[name] for name in HopperReading._fields))
        state = self.control(rig).observe(reading)
        motion = state.motion
        beyond = Limited(state.watch.stopped)
        return {
            "phase": Phase(int(tick["phase"])).name,
            "alpha_1": f"{degrees(motion.alpha_1):+.2f}°",
            "alpha_2": f"{degrees(motion.alpha_2):+.2f}°",
            "leg": f"{motion.leg_length:.4f} m",
            "hip": f"{motion.hip_height:.4f} m",
            "contact": f"{reading.contact_force:+.1f} N",
            "wanted": f"{tick['asked_1']:+.2f}, {tick['asked_2']:+.2f} N·m",
            "beyond": (beyond.name or "nothing").lower().replace("_", " ").replace("|", ", ") if beyond else "nothing",
        }

    def travels(self, rig: Rig, tick: Mapping[str, float]) -> dict[str, float]:
        """Travel of the hip by the boom's encoders, and by the leg over its foot on the ground [m]."""
        sensors = hopper_sensors(rig.sensor_model)
        leg = leg_of(self.robot)
        if tick["contact_force"] <= sensors.touchdown_force:
            return {}
        toe = foot(leg, four_bar(leg, tick["alpha_2"]), tick["alpha_1"])
        return {
            "forward by yaw": sensors.boom_length * tau * tick["boom_horizontal"] / sensors.boom_counts_horizontal,
            "forward by leg": -toe.x,
            "upward by pitch": tick["measured_height"],
            "upward by leg": -toe.y,
        }

    def limits_of(self, rig: Rig) -> SafetyLimits:
        """Limits that were given, or the rig's, or those of a simulation."""
        limits = self.limits or rig.limits or SafetyLimits.of(self.robot)
        if not isinstance(limits, SafetyLimits):
            raise RigFault(f"the rig's limits must be the hopper's SafetyLimits, not {type(limits).__name__}")
        return limits

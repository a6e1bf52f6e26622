"""A tick of hopping as one compiled function: (settings, state, inputs) → (state, torques, flags).

`hop_tick` is pure, allocates no memory, needs no interpreter lock and reads no clock; the same lines in Python give the same
bits (`as_written`). The state is one named tuple, `HopState`. `tick` is its entrance from Python: it keeps the state in a
record (`hybrid.compiled_record`), because a call that takes and returns fifty Python numbers costs ten times the tick.
"""

from typing import NamedTuple

import numpy as np

from stepgap.hopper.dynamics import Masses, leg_inertia
from stepgap.hopper.joint_control import JointLaw, flight_torque, stance_torque
from stepgap.hopper.leg import foot, four_bar
from stepgap.hopper.reduced import uprightness
from stepgap.hybrid.compiled import as_written, compiled
from stepgap.hybrid.compiled_record import assign, loaded
from stepgap.plants.estimator import (
    FlightFit,
    JointRates,
    apex_height,
    apex_passed,
    fitted_speed,
    no_samples,
    with_reading,
    with_sample,
)
from stepgap.plants.phases import Phase, next_phase
from stepgap.plants.safety import STOPS, Motion, Watch, brakes, check_torque
from stepgap.plants.tick_control import Mode, TickFlag
from stepgap.rigs.limits import SafetyLimits
from stepgap.rigs.rig import RigLayout
from stepgap.step import Reason

STEP_TIMEOUT = 4.0
"""Longest time from apex to apex [s]."""

LANDING_DAMPING = 0.5
"""Damping of each motor with which a robot that is to stop lands [N·m·s/rad]: one bounce more, no harder than a hop."""

# Numba compiles no flags, so compiled code has their numbers.
_STEP_ENDED, _FAILED, _STOPPED, _BRAKES, _TAKES_COMMAND, UNREADABLE = (
    int(flag) for flag in (
        TickFlag.STEP_ENDED, TickFlag.FAILED, TickFlag.STOPPED, TickFlag.BRAKES, TickFlag.TAKES_COMMAND,
        TickFlag.UNREADABLE,
    )
)


class TickSettings(NamedTuple):
    """All that stays the same from tick to tick.

    Attributes:
        layout: How to read the sensors.
        masses: Mass properties of the robot that the rig is taken to be.
        law: Torque laws.
        limits: What the safety function allows.
    """

    layout: RigLayout
    masses: Masses
    law: JointLaw
    limits: SafetyLimits


class TickInputs(NamedTuple):
    """What comes from outside at one tick.

    Attributes:
        time: When the tick began, since the start [s].
        age: By how much the reading is older than the tick [s].
        motor_1, motor_2, boom_horizontal, boom_vertical: Encoder counts.
        contact_force: Ground force on the foot [N].
        frame_lost, stale, late, emergency_stop: As in `Health`.
        mode: Number of the `Mode`.
        share: As in `Order`.
        force_x, force_y: Command force [N]; NaN while there is none.
        applied_1, applied_2: Torques that were applied since the tick before [N·m].
    """

    time: float
    age: float
    motor_1: float
    motor_2: float
    boom_horizontal: float
    boom_vertical: float
    contact_force: float
    frame_lost: int
    stale: int
    late: int
    emergency_stop: int
    mode: int
    share: float
    force_x: float
    force_y: float
    applied_1: float
    applied_2: float


class Flight(NamedTuple):
    """Estimate of the present flight, or of the last one.

    Attributes:
        start: Time of take-off [s].
        x: Distance travelled at take-off [m].
        fit: Line and parabola through its samples.
        last_speed: Speed at the last apex [m/s], used while this flight is too short to be fitted.
    """

    start: float = 0.0
    x: float = 0.0
    fit: FlightFit = FlightFit()
    last_speed: float = 0.0


class Hop(NamedTuple):
    """The hop that the robot is in; it ends when the apex has just been passed.

    Attributes:
        deadline: Time at which it has failed [s].
        left_ground: The leg has pushed off the ground.
        force_x: Command force that acts after mid-stance [N]; NaN until it has come.
        force_y: Upward command force [N].
        thrust_ticks: Ticks in which the command acted.
        lost_x: Sum of the command force that limits took away [N].
        lost_y: Sum of the upward command force that limits took away [N].
        reason: Number of a `Reason`: 0, or why there will be no apex.
    """

    deadline: float = STEP_TIMEOUT
    left_ground: int = 0
    force_x: float = np.nan
    force_y: float = np.nan
    thrust_ticks: int = 0
    lost_x: float = 0.0
    lost_y: float = 0.0
    reason: int = 0


class Apex(NamedTuple):
    """The last hop that ended.

    Attributes:
        speed: At its apex [m/s].
        height: At its apex [m].
        yaw: Of the boom then [rad].
        lost_x: Command force that limits took away, on average [N].
        lost_y: Upward command force that limits took away [N].
        force_x: Command force that acted [N]; NaN where none came in time.
        force_y: Upward command force that acted [N].
    """

    speed: float = np.nan
    height: float = np.nan
    yaw: float = np.nan
    lost_x: float = 0.0
    lost_y: float = 0.0
    force_x: float = np.nan
    force_y: float = np.nan


class HopState(NamedTuple):
    """All that a tick hands to the next one.

    Attributes:
        mode: Number of the `Mode`.
        phase: Number of the `Phase`.
        sampled: Time of the latest reading [s].
        motion: What the sensors say of the robot.
        rates: Estimator of the leg's rates.
        flight: Estimator of the hip's flight.
        hop: The present hop.
        apex: The last hop that ended.
        watch: Memory of the safety function.
        asked_1: Torque that the law wanted of motor 1 [N·m].
        asked_2: Torque that the law wanted of motor 2 [N·m].
        limited: Why less was written; the number of a `Limited`.
    """

    mode: int = int(Mode.STEP)
    phase: int = Phase.DESCENT.value
    sampled: float = 0.0
    motion: Motion = Motion(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    rates: JointRates = JointRates()
    flight: Flight = Flight()
    hop: Hop = Hop()
    apex: Apex = Apex()
    watch: Watch = Watch()
    asked_1: float = 0.0
    asked_2: float = 0.0
    limited: int = 0


@as_written
def hop_tick(settings, state, inputs):
    """(`HopState`, torques that may be written [N·m], flags); fields as in `TickSettings`, `HopState`, `TickInputs`."""
    hop = count_loss(settings.law, state, inputs.applied_1, inputs.applied_2)
    sampled = state.sampled if inputs.stale else inputs.time - inputs.age
    rates, motion, body = _sense(settings, state.rates, sampled, inputs)
    flight, phase = _follow(settings.layout, state, sampled, motion, body, inputs)
    hop, phase = _update_hop(hop, state.phase, phase, state.mode, inputs)
    asked = _law_torque(settings.law, phase, motion, flight, hop, inputs)
    wanted = (0.0, 0.0) if inputs.mode == Mode.LIMP else asked
    checked = check_torque(settings.limits, state.watch, motion, inputs, wanted[0], wanted[1])
    hop = _judge(settings.law.leg, hop, motion, checked.limited)
    flags, apex = 0, state.apex
    if inputs.mode == Mode.STEP and checked.limited & STOPS == 0:
        flags, hop, flight, apex = _end_hop(hop, flight, apex, phase, body, inputs.time)
    flags |= _flags(settings.limits, hop, phase, checked)
    after = HopState(
        inputs.mode, phase, sampled, motion, rates, flight, hop, apex, checked.watch, asked[0], asked[1],
        checked.limited,
    )  # fmt: skip
    return after, (checked.torque_1, checked.torque_2), flags


class Body(NamedTuple):
    """What joint and boom encoders say of the hip, besides `Motion`.

    Attributes:
        x: Distance travelled [m].
        yaw: Of the boom [rad].
        hip_rate: ẏ of the hip over a standing foot [m/s].
        shift_x: Forward offset of the free body from the hip, S sin α₁ / m_x [m].
        shift_y: Upward offset, −S cos α₁ / m_y [m].
    """

    x: float
    yaw: float
    hip_rate: float
    shift_x: float
    shift_y: float


@as_written
def _sense(settings, rates, sampled, inputs):
    """`JointRates`, `Motion` and `Body` of this tick."""
    layout = settings.layout
    phi_1 = inputs.motor_1 * _TURN / layout.motor_counts
    phi_2 = inputs.motor_2 * _TURN / layout.motor_counts
    alpha_1, alpha_2 = 0.5 * (phi_1 + phi_2), 0.5 * (phi_1 - phi_2)
    rates = with_reading(rates, sampled, alpha_1, alpha_2)
    yaw = inputs.boom_horizontal * _TURN / layout.boom_counts_horizontal
    pitch = inputs.boom_vertical * _TURN / layout.boom_counts_vertical
    x, y = layout.boom_length * yaw, layout.pivot_height + layout.boom_length * np.sin(pitch)
    length, hip_rate, shift_x, shift_y = _leg_state(settings.masses, alpha_1, alpha_2, rates.rate_1, rates.rate_2)
    motion = Motion(alpha_1, alpha_2, rates.rate_1, rates.rate_2, length, y)
    return rates, motion, Body(x, yaw, hip_rate, shift_x, shift_y)


_TURN = 2.0 * np.pi


@compiled
def _leg_state(masses, alpha_1, alpha_2, rate_1, rate_2):
    """Leg length ℓ [m], hip rate and shifts as in `Body`."""
    bar = four_bar(masses.leg, alpha_2)
    toe = foot(masses.leg, bar, alpha_1)
    moment = leg_inertia(masses, bar, alpha_2).s
    return (
        bar.length,
        -(toe.y_1 * rate_1 + toe.y_2 * rate_2),
        moment * np.sin(alpha_1) / masses.x,
        -moment * np.cos(alpha_1) / masses.y,
    )


@as_written
def _follow(layout, state, sampled, motion, body, inputs):
    """`Flight` with this tick's sample, and the phase of this tick."""
    start, x, fit, last_speed = state.flight
    airborne = state.phase == Phase.ASCENT or state.phase == Phase.DESCENT
    if airborne and not inputs.stale:
        fit = with_sample(fit, sampled - start, body.x - x + body.shift_x, motion.hip_height + body.shift_y)
    phase = next_phase(
        state.phase, apex_passed(fit), inputs.contact_force, layout.touchdown_force, motion.leg_length,
        layout.takeoff_length, body.hip_rate,
    )  # fmt: skip
    if phase == Phase.ASCENT and state.phase != Phase.ASCENT:
        start, x, fit = sampled, body.x, no_samples()
    return Flight(start, x, fit, last_speed), phase


@as_written
def count_loss(law, state, applied_1, applied_2):
    """`Hop` with the command force that limits took away in the last tick, if the command acted in it."""
    hop = state.hop
    if state.phase != Phase.THRUST:
        return hop
    lost_x, lost_y = hop.lost_x, hop.lost_y
    lost_1, lost_2 = state.asked_1 - applied_1, state.asked_2 - applied_2
    if lost_1 != 0.0 or lost_2 != 0.0:
        force_x, force_y = _lost_force(law, state.motion.alpha_1, state.motion.alpha_2, lost_1, lost_2)
        lost_x, lost_y = lost_x + force_x, lost_y + force_y
    return Hop(
        hop.deadline, hop.left_ground, hop.force_x, hop.force_y, hop.thrust_ticks + 1, lost_x, lost_y, hop.reason
    )  # fmt: skip


@compiled
def _lost_force(law, alpha_1, alpha_2, lost_1, lost_2):
    """Force on the body that torques (lost_1, lost_2) make in stance: the inverse of τ = −Jᵀ force."""
    toe = foot(law.leg, four_bar(law.leg, alpha_2), alpha_1)
    q_1, q_2 = lost_1 + lost_2, lost_1 - lost_2
    determinant = toe.x_1 * toe.y_2 - toe.x_2 * toe.y_1
    return (toe.y_1 * q_2 - toe.y_2 * q_1) / determinant, (toe.x_2 * q_1 - toe.x_1 * q_2) / determinant


@as_written
def _update_hop(hop, before, phase, mode_before, inputs):
    """`Hop` and the phase of this tick, with take-off, deadline, release and command taken into account."""
    deadline, left_ground, force_x, force_y = hop.deadline, hop.left_ground, hop.force_x, hop.force_y
    thrust_ticks, lost_x, lost_y = hop.thrust_ticks, hop.lost_x, hop.lost_y
    if phase == Phase.COMPRESSION and before != Phase.COMPRESSION:
        deadline = min(deadline, inputs.time + STEP_TIMEOUT)
    if before == Phase.THRUST and phase != Phase.THRUST:
        left_ground = 1
    if inputs.mode == Mode.STEP and mode_before != Mode.STEP:
        # the robot is held in the air, and may be for as long as it takes
        phase = Phase.DESCENT.value
        deadline, left_ground, force_x, force_y, thrust_ticks, lost_x, lost_y, _ = _new_hop(np.inf, hop.reason)
    if inputs.mode == Mode.STEP and np.isnan(force_x) and _takes_command(phase, left_ground):
        force_x, force_y = inputs.force_x, inputs.force_y
    return Hop(deadline, left_ground, force_x, force_y, thrust_ticks, lost_x, lost_y, hop.reason), phase


@as_written
def _new_hop(deadline, reason):
    """`Hop` at its begin."""
    return Hop(deadline, 0, np.nan, np.nan, 0, 0.0, 0.0, reason)


@as_written
def _takes_command(phase, left_ground):
    """Whether a command can still act in full: mid-stance is ahead."""
    return (phase == Phase.DESCENT or phase == Phase.COMPRESSION) and left_ground == 0


@as_written
def _law_torque(law, phase, motion, flight, hop, inputs):
    """Torques that the law of the mode wants [N·m]."""
    grounded = phase == Phase.COMPRESSION or phase == Phase.THRUST
    if inputs.mode == Mode.POSTURE or not grounded:
        share = inputs.share if inputs.mode == Mode.POSTURE else 1.0
        torque_1, torque_2 = _posture_torque(law, motion, flight)
        return share * torque_1, share * torque_2
    if inputs.mode == Mode.LAND:
        return _landing_torque(law, motion, inputs.share)
    acts = phase == Phase.THRUST and not np.isnan(hop.force_x)
    force_x, force_y = (hop.force_x, hop.force_y) if acts else (0.0, 0.0)
    return _stance_torque(law, motion.alpha_1, motion.alpha_2, force_x, force_y)


@as_written
def _posture_torque(law, motion, flight):
    """Torques that hold the landing posture [N·m]."""
    speed = fitted_speed(flight.fit)
    if np.isnan(speed):
        speed = flight.last_speed
    return flight_torque(law, motion.alpha_1, motion.alpha_2, motion.rate_1, motion.rate_2, speed)


@as_written
def _landing_torque(law, motion, share):
    """Torques that end the hopping on the ground [N·m]: a damped spring that fades away until only damping is left."""
    spring = max(0.0, 1.0 - share)
    torque_1, torque_2 = _stance_torque(law, motion.alpha_1, motion.alpha_2, 0.0, 0.0)
    return (
        spring * torque_1 - LANDING_DAMPING * (motion.rate_1 + motion.rate_2),
        spring * torque_2 - LANDING_DAMPING * (motion.rate_1 - motion.rate_2),
    )


@compiled
def _stance_torque(law, alpha_1, alpha_2, force_x, force_y):
    bar = four_bar(law.leg, alpha_2)
    toe = foot(law.leg, bar, alpha_1)
    return stance_torque(law, bar, toe, np.sin(alpha_1), np.cos(alpha_1), force_x, force_y)


@as_written
def _judge(leg, hop, motion, limited):
    """`Hop` with the reason why there will be no apex, if the safety function stopped the robot or it fell."""
    reason = hop.reason
    if limited & STOPS:
        reason = Reason.STOPPED.value
    elif uprightness(leg, motion.hip_height, motion.alpha_1, motion.alpha_2) < 0.0:
        reason = Reason.FELL.value
    return _with_reason(hop, reason)


@as_written
def _with_reason(hop, reason):
    return Hop(
        hop.deadline, hop.left_ground, hop.force_x, hop.force_y, hop.thrust_ticks, hop.lost_x, hop.lost_y, reason
    )  # fmt: skip


@as_written
def _end_hop(hop, flight, apex, phase, body, time):
    """(flags, `Hop`, `Flight`, `Apex`) where the hop may have ended.

    A flight that is too short to be measured ends no hop: the robot bounced, and hops on.
    """
    if hop.reason == Reason.OK and hop.left_ground and phase == Phase.DESCENT:
        speed = fitted_speed(flight.fit)
        height = apex_height(flight.fit) - body.shift_y
        if not np.isnan(speed):
            flight = Flight(flight.start, flight.x, flight.fit, speed)
        if np.isfinite(speed + height):
            lost_x, lost_y = mean_loss(hop)
            ended = Apex(speed, height, body.yaw, lost_x, lost_y, hop.force_x, hop.force_y)
            return _STEP_ENDED, _new_hop(time + STEP_TIMEOUT, hop.reason), flight, ended
    if time > hop.deadline:
        hop = _with_reason(hop, Reason.NO_APEX.value if hop.left_ground else Reason.NO_TAKE_OFF.value)
    return 0, hop, flight, apex


@as_written
def mean_loss(hop):
    """Mean command force that limits took away while the command acted [N]."""
    ticks = max(1, hop.thrust_ticks)
    return hop.lost_x / ticks, hop.lost_y / ticks


@as_written
def _flags(limits, hop, phase, checked):
    """Sum of the flags, but for the end of a step."""
    flags = 0
    if hop.reason != Reason.OK:
        flags |= _FAILED
    if checked.limited & STOPS:
        flags |= _STOPPED
        if brakes(limits, checked.watch):
            flags |= _BRAKES
    if _takes_command(phase, hop.left_ground):
        flags |= _TAKES_COMMAND
    return flags


@as_written
def tick(
    settings, memory, row, time, age, motor_1, motor_2, boom_horizontal, boom_vertical, contact_force, frame_lost, stale,
    late, emergency_stop, mode, share, force_x, force_y, applied_1, applied_2,
):  # fmt: skip
    """`hop_tick` on a state in memory; a reading that is not finite changes nothing.

    Args:
        settings: Record of `TickSettings`.
        memory: Record of `HopState`; that of the tick before, afterwards that of this tick.
        row: Takes the fields of `TICK_UNITS`, but for the torques that will be applied; shape (14,).
        time: As the other arguments, a field of `TickInputs`.

    Returns:
        Torques that may be written [N·m], and the sum of the flags.
    """
    if not np.isfinite(motor_1 + motor_2 + boom_horizontal + boom_vertical + contact_force):
        return (0.0, 0.0), UNREADABLE
    inputs = TickInputs(
        time, age, motor_1, motor_2, boom_horizontal, boom_vertical, contact_force, int(frame_lost), int(stale),
        int(late), int(emergency_stop), int(mode), share, force_x, force_y, applied_1, applied_2,
    )  # fmt: skip
    state, torques, flags = hop_tick(settings[0], loaded(memory[0], HopState), inputs)
    assign(memory[0], state)
    row[0], row[1], row[2], row[3], row[4], row[5] = time, motor_1, motor_2, boom_horizontal, boom_vertical, contact_force
    row[6], row[7], row[8] = state.phase, state.motion.alpha_1, state.motion.alpha_2
    row[9], row[10], row[13] = state.asked_1, state.asked_2, state.limited
    return torques, flags


@as_written
def broken_off(settings, memory, applied_1, applied_2):
    """(fx, fy, lost fx, lost fy) of the hop so far [N]: what acted, and what limits took away from it.

    Args:
        settings: Record of `TickSettings`.
        memory: Record of `HopState`.
        applied_1: Torque that was applied after the last tick [N·m]; NaN where none was.
        applied_2: Torque that was applied after the last tick [N·m].
    """
    state = loaded(memory[0], HopState)
    hop = state.hop if np.isnan(applied_1) else count_loss(settings[0].law, state, applied_1, applied_2)
    lost_x, lost_y = mean_loss(hop)
    return hop.force_x, hop.force_y, lost_x, lost_y

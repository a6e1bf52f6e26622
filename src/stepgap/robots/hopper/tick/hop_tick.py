"""One tick of the hopper's control as a compiled function: (settings, state, inputs) → (state, torques, flags).

A *tick* is one period of the control loop, normally 1 ms: sensor counts in, motor torques out. In every tick,
`hop_tick` estimates the motion, finds the phase of the hop, computes the torques and limits them for safety.

`hop_tick` is pure: it allocates no memory, needs no interpreter lock and reads no clock. Its whole state is one named
tuple, `HopState`. Python calls `tick`, which keeps the state in a NumPy record (`base.compiled_record`): to pass and
return the fifty numbers of the state as Python objects would take ten times as long as the tick. `as_written` compiles
a function so that its results are, to the last bit, those of the same code in Python.
"""

import numpy as np

from stepgap.base.compiled import as_written, from_python
from stepgap.base.compiled_record import assign, loaded
from stepgap.plants.tick_control import Mode, TickFlag
from stepgap.robots.hopper.model.joint_control import landing_posture
from stepgap.robots.hopper.model.leg import foot, four_bar
from stepgap.robots.hopper.model.reduced import uprightness
from stepgap.robots.hopper.tick.drive_motion import judge_motion
from stepgap.robots.hopper.tick.estimator import after_vertex, fitted_apex
from stepgap.robots.hopper.tick.hop_state import (
    STEP_TIMEOUT,
    Apex,
    FlightState,
    HopProgress,
    HopState,
    Landing,
    TickInputs,
)
from stepgap.robots.hopper.tick.load import add_load
from stepgap.robots.hopper.tick.phases import Phase
from stepgap.robots.hopper.tick.plausibility import judge_sensors
from stepgap.robots.hopper.tick.safety import DOUBTS, STOPS, JointMotion, brakes, check_torque
from stepgap.robots.hopper.tick.sensing import sense, update_flight, yaw_of
from stepgap.robots.hopper.tick.stage import stage_of
from stepgap.robots.hopper.tick.tick_row import TICK_COLUMN
from stepgap.robots.hopper.tick.tick_torque import lost_force, wanted_torque
from stepgap.step import StepStatus

# Numba cannot compile enum flags, so compiled code uses their integer values.
_STEP_ENDED, _FAILED, _STOPPED, _BRAKES, _TAKES_COMMAND, UNREADABLE, _TOUCHDOWN = map(int, TickFlag)

_DOUBTS = int(DOUBTS)

LARGEST_DROP = 0.2
"""Step down that a robot may fly over on uneven ground without having fallen [m]; the ground below is not known yet."""


SHORT_HOP = 0.03
"""Distance of two footholds from which a slope follows [m]; their heights are right to a millimetre."""

LATELY = 0.15
"""Weight of the latest foothold in the mean by which footholds lie beyond where they were expected."""

STEEPEST = 0.3  # Largest slope that two footholds show; what rises more is a riser


@as_written
def hop_tick(settings, state, inputs):
    """Computes one tick.

    Args:
        settings: `TickSettings`.
        state: `HopState` after the tick before.
        inputs: `TickInputs`.

    Returns:
        `HopState` after this tick, torques that may be written [N·m], and the sum of the `TickFlag`s.
    """
    # The order matters. What limits took away belongs to the phase of the tick before, so it is added before the phase
    # changes; the law acts on a command in the tick that brings it; and a step fails before it could end as good.
    hop = _add_lost_force(settings.law, state, inputs.applied_1, inputs.applied_2)
    sampled = state.sampled if inputs.stale else inputs.time - inputs.age  # when the sensors were read [s]
    rates, motion, body = sense(settings, state.rates, sampled, inputs)
    flight, phase = update_flight(settings.sensor_model, state, sampled, motion, body, inputs)
    hop, phase = _update_hop(hop, state.phase, phase, state.mode, inputs)
    landing = _landing(state, phase, motion, body, inputs.contact_force)
    asked = wanted_torque(settings.law, phase, motion, flight, hop, inputs)
    requested = (0.0, 0.0) if inputs.mode == Mode.LIMP else asked  # a limp robot only logs what the law asks for
    sensors, doubts = judge_sensors(settings, state, sampled, phase, motion, body, flight, inputs)
    drives, disobeys = judge_motion(settings, state, sampled, motion, inputs)
    doubts |= disobeys if doubts == 0 else 0  # a sensor that is known to be wrong explains the motion
    load, overload = add_load(
        settings.limits, settings.sensor_model.tick, state.load, motion, inputs.applied_1, inputs.applied_2
    )
    stage = stage_of(settings.limits, inputs.mode, inputs.share, state.hops)
    over_ground = _above(motion, landing.ground if settings.uneven else 0.0)
    checked = check_torque(
        settings.limits, stage, state.watch, over_ground, inputs, doubts | overload, requested[0], requested[1]
    )
    drop = LARGEST_DROP if settings.uneven and (phase == Phase.ASCENT or phase == Phase.DESCENT) else 0.0
    hop = _update_status(settings.law.leg, hop, over_ground, drop, checked.limited)
    flags = 0
    apex = state.apex
    if inputs.mode == Mode.STEP and checked.limited & STOPS == 0:
        flags, hop, flight, apex = _end_hop(settings, hop, flight, landing, apex, phase, body, inputs.time)
    flags |= _flags(settings.limits, hop, phase, checked)
    if inputs.mode == Mode.STEP and phase == Phase.COMPRESSION and state.phase != Phase.COMPRESSION:
        flags |= _TOUCHDOWN
    after = HopState(
        mode=inputs.mode, phase=phase, sampled=sampled, motion=motion, rates=rates, flight=flight, hop=hop,
        landing=landing, apex=apex, sensors=sensors, drives=drives, watch=checked.watch, asked_1=asked[0],
        asked_2=asked[1], limited=checked.limited, hops=state.hops + int(flags & _STEP_ENDED != 0), stage=stage,
        load=load,
    )  # fmt: skip
    return after, (checked.torque_1, checked.torque_2), flags


@as_written
def _landing(state, phase, motion, body, contact_force):
    """`Landing` of this tick: in the first one of a stance, where leg and boom find the foot; then how it sinks."""
    last = state.landing
    height = motion.hip_height + body.foot_y
    if phase == Phase.ASCENT or phase == Phase.DESCENT:
        return last
    if phase == Phase.THRUST or state.phase == Phase.COMPRESSION:
        return Landing(
            ground=last.ground, foothold=last.foothold, slope=last.slope, yielding=last.yielding,
            deepest=max(last.deepest, last.ground - height), strongest=max(last.strongest, contact_force),
            farther=last.farther,
        )  # fmt: skip
    foothold = body.x + body.foot_x
    slope = last.slope
    farther = last.farther
    if np.isfinite(state.apex.next_foothold):
        farther += LATELY * (foothold - state.apex.next_foothold)
    if state.hops > 0 and abs(foothold - last.foothold) > SHORT_HOP:
        slope = (height - last.ground) / (foothold - last.foothold)
    return Landing(
        ground=height, foothold=foothold, slope=min(max(slope, -STEEPEST), STEEPEST),
        yielding=last.deepest / last.strongest if last.strongest > 0.0 else 0.0, deepest=0.0, strongest=0.0,
        farther=farther,
    )  # fmt: skip


@as_written
def _above(motion, ground):
    """`JointMotion` with the height of the hip above a ground [m]."""
    return JointMotion(
        alpha_1=motion.alpha_1, alpha_2=motion.alpha_2, rate_1=motion.rate_1, rate_2=motion.rate_2,
        leg_length=motion.leg_length, hip_height=motion.hip_height - ground,
    )  # fmt: skip


@as_written
def _add_lost_force(law, state, applied_1, applied_2):
    """`HopProgress` with the command force that was lost to torque limits in the last tick, if it was in THRUST.

    The lost force is that of the requested torques minus that of the applied torques.
    """
    hop = state.hop
    if state.phase != Phase.THRUST:
        return hop
    lost_x = hop.lost_x
    lost_y = hop.lost_y
    lost_1 = state.asked_1 - applied_1
    lost_2 = state.asked_2 - applied_2
    if lost_1 != 0.0 or lost_2 != 0.0:
        force_x, force_y = lost_force(law, state.motion.alpha_1, state.motion.alpha_2, lost_1, lost_2)
        lost_x = lost_x + force_x
        lost_y = lost_y + force_y
    return HopProgress(
        deadline=hop.deadline, left_ground=hop.left_ground, force_x=hop.force_x, force_y=hop.force_y,
        thrust_ticks=hop.thrust_ticks + 1, lost_x=lost_x, lost_y=lost_y, status=hop.status,
    )  # fmt: skip


@as_written
def _update_hop(hop, before, phase, mode_before, inputs):
    """`HopProgress` and the phase of this tick: updates takeoff, deadline, release from the hold, and command."""
    deadline = hop.deadline
    left_ground = hop.left_ground
    force_x = hop.force_x
    force_y = hop.force_y
    thrust_ticks = hop.thrust_ticks
    lost_x = hop.lost_x
    lost_y = hop.lost_y
    if phase == Phase.COMPRESSION and before != Phase.COMPRESSION:
        deadline = min(deadline, inputs.time + STEP_TIMEOUT)
    if before == Phase.THRUST and phase != Phase.THRUST:
        left_ground = 1
    if inputs.mode == Mode.STEP and mode_before != Mode.STEP:
        # the robot is held in the air, for any time, so there is no deadline until touchdown
        phase = Phase.DESCENT.value
        deadline, left_ground, force_x, force_y, thrust_ticks, lost_x, lost_y, _ = _new_hop(np.inf, hop.status)
    if inputs.mode == Mode.STEP and not np.isnan(inputs.force_x) and _takes_command(phase, left_ground):
        force_x = inputs.force_x
        force_y = inputs.force_y
    return HopProgress(
        deadline=deadline, left_ground=left_ground, force_x=force_x, force_y=force_y, thrust_ticks=thrust_ticks,
        lost_x=lost_x, lost_y=lost_y, status=hop.status,
    ), phase  # fmt: skip


@as_written
def _new_hop(deadline, status):
    """`HopProgress` at the start of a hop."""
    return HopProgress(
        deadline=deadline, left_ground=0, force_x=np.nan, force_y=np.nan, thrust_ticks=0, lost_x=0.0, lost_y=0.0,
        status=status,
    )  # fmt: skip


@as_written
def _takes_command(phase, left_ground):
    """Whether a command that comes now acts during the whole thrust, because mid-stance is still to come."""
    return (phase == Phase.DESCENT or phase == Phase.COMPRESSION) and left_ground == 0


@as_written
def _update_status(leg, hop, motion, drop, limited):
    """`HopProgress` with a new status if the step has failed: the safety function stopped the robot, or it fell.

    Its height is judged above a ground that may be lower by `drop` [m].
    """
    status = hop.status
    if limited & STOPS:
        status = StepStatus.DOUBTFUL.value if limited & _DOUBTS else StepStatus.STOPPED.value
    elif uprightness(leg, motion.hip_height + drop, motion.alpha_1, motion.alpha_2) < 0.0:
        status = StepStatus.FELL.value
    return _with_status(hop, status)


@as_written
def _with_status(hop, status):
    return HopProgress(
        deadline=hop.deadline, left_ground=hop.left_ground, force_x=hop.force_x, force_y=hop.force_y,
        thrust_ticks=hop.thrust_ticks, lost_x=hop.lost_x, lost_y=hop.lost_y, status=status,
    )  # fmt: skip


@as_written
def _end_hop(settings, hop, flight, landing, apex, phase, body, time):
    """Ends the hop if the robot has just passed the apex; fails it if its time is over.

    After a flight that is too short for an estimate of speed and height, the hop does not end: the robot has bounced.

    Returns:
        Flags, `HopProgress`, `FlightState` and `Apex`.
    """
    if hop.status == StepStatus.OK and hop.left_ground and phase == Phase.DESCENT:
        model = settings.sensor_model
        speed, top = fitted_apex(flight.fit, model.boom_length * yaw_of(model, 1.0))
        height = top - body.shift_y
        if np.isfinite(speed + height):
            lost_x, lost_y = _mean_loss(hop)
            at_apex = body.x - speed * after_vertex(flight.fit)
            ahead = _descent(settings, speed, height - landing.ground)
            flight = FlightState(flight.start, flight.x, flight.fit, speed)
            ended = Apex(
                speed=speed, height=height, yaw=body.yaw, lost_x=lost_x, lost_y=lost_y, force_x=hop.force_x,
                force_y=hop.force_y, next_foothold=at_apex + ahead + landing.farther,
            )  # fmt: skip
            return _STEP_ENDED, _new_hop(time + STEP_TIMEOUT, hop.status), flight, ended
    if time > hop.deadline:
        hop = _with_status(hop, StepStatus.NO_APEX.value if hop.left_ground else StepStatus.NO_TAKE_OFF.value)
    return 0, hop, flight, apex


@as_written
def _descent(settings, speed, height):
    """Distance from an apex to the next foothold [m], with the height above the ground [m], which may change."""
    alpha_1, alpha_2 = landing_posture(settings.law, speed)
    toe = foot(settings.law.leg, four_bar(settings.law.leg, alpha_2), alpha_1)
    fall = max(height + toe.y, 0.0)
    return speed * np.sqrt(2.0 * fall * settings.masses.y / settings.masses.weight) + toe.x


@as_written
def _mean_loss(hop):
    """Mean command force that was lost to torque limits during THRUST [N]."""
    ticks = max(1, hop.thrust_ticks)
    return hop.lost_x / ticks, hop.lost_y / ticks


@as_written
def _flags(limits, hop, phase, checked):
    """Sum of all flags except `STEP_ENDED`."""
    flags = 0
    if hop.status != StepStatus.OK:
        flags |= _FAILED
    if checked.limited & STOPS:
        flags |= _STOPPED
        if brakes(limits, checked.watch.stopped, checked.watch.braked):
            flags |= _BRAKES
    if _takes_command(phase, hop.left_ground):
        flags |= _TAKES_COMMAND
    return flags


@from_python
@as_written
def tick(
    settings, memory, row, time, age, motor_1, motor_2, boom_horizontal, boom_vertical, contact_force, frame_lost,
    stale, late, emergency_stop, mode, share, force_x, force_y, applied_1, applied_2,
):  # fmt: skip
    """Runs `hop_tick` on a state in memory; after a reading that is not finite, the state is left as it was.

    Args:
        settings: Record of `TickSettings`.
        memory: Record of `HopState`, which is updated.
        row: Row of the tick log, which is filled with the fields of `TICK_UNITS` except the applied torques, not known
            yet; shape (fields,).
        time: This and the other arguments are the fields of `TickInputs`.

    Returns:
        Torques that may be written [N·m], and the sum of the flags.
    """
    if not np.isfinite(motor_1 + motor_2 + boom_horizontal + boom_vertical + contact_force):
        return (0.0, 0.0), UNREADABLE
    inputs = TickInputs(
        time=time, age=age, motor_1=motor_1, motor_2=motor_2, boom_horizontal=boom_horizontal,
        boom_vertical=boom_vertical, contact_force=contact_force, frame_lost=int(frame_lost), stale=int(stale),
        late=int(late), emergency_stop=int(emergency_stop), mode=int(mode), share=share, force_x=force_x,
        force_y=force_y, applied_1=applied_1, applied_2=applied_2,
    )  # fmt: skip
    state, torques, flags = hop_tick(settings[0], loaded(memory[0], HopState), inputs)  # pyright: ignore[reportCallIssue]
    assign(memory[0], state)
    motion = state.motion
    row[TICK_COLUMN.time] = time
    row[TICK_COLUMN.motor_1] = motor_1
    row[TICK_COLUMN.motor_2] = motor_2
    row[TICK_COLUMN.boom_horizontal] = boom_horizontal
    row[TICK_COLUMN.boom_vertical] = boom_vertical
    row[TICK_COLUMN.contact_force] = contact_force
    row[TICK_COLUMN.phase] = state.phase
    row[TICK_COLUMN.limited] = state.limited
    row[TICK_COLUMN.alpha_1] = motion.alpha_1
    row[TICK_COLUMN.alpha_2] = motion.alpha_2
    row[TICK_COLUMN.asked_1] = state.asked_1
    row[TICK_COLUMN.asked_2] = state.asked_2
    row[TICK_COLUMN.rate_1] = motion.rate_1
    row[TICK_COLUMN.rate_2] = motion.rate_2
    row[TICK_COLUMN.joint_speed] = abs(motion.rate_1) + abs(motion.rate_2)
    row[TICK_COLUMN.leg_length] = motion.leg_length
    row[TICK_COLUMN.measured_height] = motion.hip_height
    ground = state.landing.ground if settings[0].uneven else 0.0
    row[TICK_COLUMN.height_above_ground] = motion.hip_height - ground
    return torques, flags


@from_python
@as_written
def interrupted_hop(settings, memory, applied_1, applied_2):
    """Returns (fx, fy, lost fx, lost fy) of the hop so far [N]: the command that acted and its part lost to limits.

    Args:
        settings: Record of `TickSettings`.
        memory: Record of `HopState`.
        applied_1: Torque applied after the last tick [N·m]; NaN if none was applied.
        applied_2: Torque applied after the last tick [N·m].
    """
    state = loaded(memory[0], HopState)  # pyright: ignore[reportCallIssue]
    hop = state.hop if np.isnan(applied_1) else _add_lost_force(settings[0].law, state, applied_1, applied_2)
    lost_x, lost_y = _mean_loss(hop)
    return hop.force_x, hop.force_y, lost_x, lost_y

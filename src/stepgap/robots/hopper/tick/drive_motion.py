"""Does the leg move as the commands let expect? A drive may report a torque that it does not give; compiled.

The dynamics that the package has say which generalised torques Q = (τ₁ + τ₂, τ₁ − τ₂) the accelerations of the leg
need. In flight both follow from the motors' encoders alone. In stance the force on the foot is measured, but only its
vertical part. With r the foot relative to the hip, Q₂ − k Q₁ with k = (∂r_x/∂α₂) / (∂r_x/∂α₁) does not depend on the
horizontal part; Q₁ alone takes the foot as pinned, and only tells the drives apart.

Commands and torques of the motion pass the same low-pass filter, and are compared as

    torque of the motion ≈ gain · command some ticks before.

Gain and delay are the robot's own, as is the largest deviation: it learns them in its first stances. Then a motion that
deviates by more than its bound for some ticks stops the robot. An error of scale, which is a smaller deviation, shows
in the gain of a whole stance, which a healthy robot repeats to some percent.
"""

from typing import NamedTuple

import numpy as np

from stepgap.base.compiled import as_written, compiled
from stepgap.plants.tick_control import Mode
from stepgap.robots.hopper.model.dynamics import terms
from stepgap.robots.hopper.model.leg import foot, four_bar
from stepgap.robots.hopper.tick.safety import Limited

FILTER_TIME = 2.5e-3
SIDEWAYS_TIME = 10e-3
"""Time constants of the filters [s]; long for Q₁ in stance, where rounding of the encoders moves the whole body."""

LEARNING_STANCES = 3
"""Number of stances after which a robot is judged by what it has learned of itself."""

_LEAST_GAIN = 0.2
_MOST_GAIN = 1.5
"""Range of the gain: a motor that saturates, with a rotor that the model does not have, gives half of its command."""

_FAST = 0.02
_SLOW = 5e-4
"""Steps by which the gain follows in the first stances and later; what changes slowly is wear, not a fault."""

SHORTEST_TICK = 8e-4
"""Shortest tick that is judged [s]; in shorter ones, drives and their filters are late by more ticks than are tried."""

_MOST_DELAY = 3  # Largest delay that is tried, besides that of one tick [ticks]

_FIRST_SHARE = 0.8
_SHARE = 0.3
"""Part of the command by which the motion may deviate besides its bound, in the first stances and later."""

_FIRST_BOUND = 3.0
_MARGIN = 1.6
_MOST_LEARNED = 6.0
"""Bound in the first stances as a multiple of `motion_torque`; later as one of the largest own deviation, and the most
that is learned of that as a multiple of `motion_torque`: links of some robots ring in flight."""

_UNEVEN = 2
"""Factor of `motion_torque` and `WRONG_TICKS` on uneven ground: risers push a foot, and slopes brush it before its
force is that of a touchdown."""

WRONG_TICKS = 3
"""Number of ticks in a row in which the motion deviates, after which a drive is doubted."""

_CLEARLY = 2  # Number of ticks for which a tick counts whose motion deviates by twice the bound or more

_JUDGED_FROM = 3
_LEARNED_FROM = 8
"""Number of ticks after a change of contact, or a gap, from which motion is judged, besides the delay; and learned."""

LOADED_FROM = 10
LEAST_LOADED = 30
"""Number of ticks of a stance from which its gain is measured, and the least number of such ticks."""

LEAST_RATIO = 0.8
MOST_RATIO = 1.25
"""Range of the gain of a stance, as a multiple of the slow mean of those before."""

_MEAN_GAIN = 0.1  # Weight of the latest stance in that mean

GRIP = 0.7
"""Horizontal force, as a part of the vertical one, beyond which the foot slips; an impact would seem to need more."""

_JITTER = 0.1
"""Largest error of the time between readings from which the acceleration is taken, in ticks: it counts as no error."""

ALONE = 3.0
"""Ratio of the deviations of two motors from which one drive alone is doubted."""

_BETWEEN = 0
_FLIGHT = 1
_STANCE = 2
"""Contact in three readings in a row: it changed, there was none, or there was."""

_MOTOR_1 = int(Limited.MOTOR_1_DISOBEYS)
_MOTOR_2 = int(Limited.MOTOR_2_DISOBEYS)


class Follows(NamedTuple):
    """How the motion follows the commands in one direction.

    Attributes:
        gain: Torque of the motion per command.
        most: Largest deviation beyond `_SHARE` of the command in the first stances, in torques commanded [N·m].
    """

    gain: float = 0.7
    most: float = 0.0


class Compared(NamedTuple):
    """Filtered torques in one direction since the contact changed [N·m].

    Attributes:
        moved: Torque that the motion needs.
        sent: Command.
        sent_1, sent_2, sent_3: Commands 1 to 3 ticks before.
    """

    moved: float = 0.0
    sent: float = 0.0
    sent_1: float = 0.0
    sent_2: float = 0.0
    sent_3: float = 0.0


_NOTHING = Compared()


class Delays(NamedTuple):
    """Sums in the first flights, by which the delay is found.

    Attributes:
        product_0, product_1, product_2, product_3: Σ of the torque of the motion times the command with each delay.
        square_0, square_1, square_2, square_3: Σ of the square of that command.
        delay: Delay with which commands explain the motion best [ticks].
    """

    product_0: float = 0.0
    product_1: float = 0.0
    product_2: float = 0.0
    product_3: float = 0.0
    square_0: float = 0.0
    square_1: float = 0.0
    square_2: float = 0.0
    square_3: float = 0.0
    delay: int = 1


class Loaded(NamedTuple):
    """Sums over the present stance of filtered torques, and the gains of the stances before.

    Attributes:
        ticks: Number of ticks.
        product: Σ of the torque of the motion times the command [N²·m²].
        square: Σ of the command's square [N²·m²].
        sent_1, sent_2: Σ of the commands [N·m].
        moved_1, moved_2: Σ of the torques of the motion [N·m].
        stances: Number of stances before.
        mean: Slow mean of their gains.
    """

    ticks: int = 0
    product: float = 0.0
    square: float = 0.0
    sent_1: float = 0.0
    sent_2: float = 0.0
    moved_1: float = 0.0
    moved_2: float = 0.0
    stances: int = 0
    mean: float = 0.0


class Disobedience(NamedTuple):
    """What the motors were commanded when a drive was doubted, and what moved the leg, in torques commanded [N·m]."""

    sent_1: float = np.nan
    sent_2: float = np.nan
    moved_1: float = np.nan
    moved_2: float = np.nan


class Applied(NamedTuple):
    """Torques applied in the last two intervals between ticks, the latest first [N·m]."""

    latest_1: float = 0.0
    latest_2: float = 0.0
    before_1: float = 0.0
    before_2: float = 0.0


class DriveMotion(NamedTuple):
    """State of the judgement.

    Attributes:
        applied: Torques before this tick.
        force: Contact force of the latest reading [N]; 0 below the threshold.
        force_before: That of the reading before [N].
        contact: `_BETWEEN`, `_FLIGHT` or `_STANCE`.
        ticks: Number of ticks compared since it changed.
        settled: Number of them since a reading was missing.
        flight_1, flight_2: How the motion follows the commands in flight, in directions 1 and 2.
        stance: The same in stance, in direction 2.
        compared_1, compared_2: What is compared now.
        loaded: The stances.
        delays: The delay of the commands.
        wrong: Number of ticks in a row in which the motion deviates; a clear one counts as `_CLEARLY`.
        doubted: Torques when a drive was doubted.
    """

    applied: Applied = Applied()
    force: float = 0.0
    force_before: float = 0.0
    contact: int = _BETWEEN
    ticks: int = 0
    settled: int = 0
    flight_1: Follows = Follows()
    flight_2: Follows = Follows()
    stance: Follows = Follows()
    compared_1: Compared = Compared()
    compared_2: Compared = Compared()
    loaded: Loaded = Loaded()
    delays: Delays = Delays()
    wrong: int = 0
    doubted: Disobedience = Disobedience()


@as_written
def judge_motion(settings, state, sampled, motion, inputs):
    """Returns `DriveMotion` after this tick, and the drives to doubt, as the number of a `Limited`.

    Args:
        settings: `TickSettings`.
        state: `HopState` after the tick before.
        sampled: Time of the reading [s].
        motion: `JointMotion` of this tick.
        inputs: `TickInputs`.
    """
    before = state.drives
    is_judged = settings.limits.motion_torque < np.inf and settings.sensor_model.tick >= SHORTEST_TICK
    if not is_judged or inputs.mode != Mode.STEP or state.watch.stopped != 0:
        return before, 0
    force = inputs.contact_force if inputs.contact_force > settings.sensor_model.touchdown_force else 0.0
    after = before
    doubts = 0
    if not _is_regular(state.rates, sampled, settings.sensor_model.tick):
        after = _restarted(before)  # torques in a gap would be missing in the filters
    else:
        contact = _contact(force, before.force, before.force_before)
        if contact != before.contact:
            after, doubts = _begun(before, contact, settings.uneven)
        if contact != _BETWEEN:
            after = _compared(settings, state, after, motion, inputs)
            lenience = _UNEVEN if settings.uneven else 1
            after, wrong = _judged(lenience * settings.limits.motion_torque, lenience * WRONG_TICKS, after)
            doubts |= wrong
    applied = Applied(
        latest_1=inputs.applied_1, latest_2=inputs.applied_2, before_1=before.applied.latest_1,
        before_2=before.applied.latest_2,
    )  # fmt: skip
    return DriveMotion(
        applied=applied, force=force, force_before=before.force, contact=after.contact, ticks=after.ticks,
        settled=after.settled, flight_1=after.flight_1, flight_2=after.flight_2, stance=after.stance,
        compared_1=after.compared_1, compared_2=after.compared_2, loaded=after.loaded, delays=after.delays,
        wrong=after.wrong, doubted=after.doubted,
    ), doubts  # fmt: skip


@as_written
def _is_regular(rates, sampled, tick):
    """Whether the last three readings are a tick apart."""
    late = max(abs(sampled - rates.time - tick), abs(rates.time - rates.time_before - tick))
    return rates.readings == 2 and late < _JITTER * tick


@as_written
def _contact(latest, before, earlier):
    """Contact in three readings with these forces [N]."""
    if latest > 0.0 and before > 0.0 and earlier > 0.0:
        return _STANCE
    return _BETWEEN if latest > 0.0 or before > 0.0 or earlier > 0.0 else _FLIGHT


@as_written
def _begun(before, contact, uneven):
    """`DriveMotion` at the first tick of another contact, and the drives to doubt by the stance that ended.

    On uneven ground a stance is not judged as a whole, since its gain depends on the slope.
    """
    loaded = before.loaded
    doubted = before.doubted
    doubts = 0
    stances = loaded.stances
    mean = loaded.mean
    if loaded.ticks >= LEAST_LOADED:
        gain = loaded.product / loaded.square
        stances += 1
        ratio = gain / mean if stances > LEARNING_STANCES and not uneven else 1.0
        if LEAST_RATIO <= ratio <= MOST_RATIO:
            mean += max(1.0 / stances, _MEAN_GAIN) * (gain - mean)
        else:
            scale = 1.0 / (loaded.ticks * mean)
            doubted, doubts = _disobedience(
                loaded.sent_1 / loaded.ticks, loaded.sent_2 / loaded.ticks, scale * loaded.moved_1,
                scale * loaded.moved_2,
            )  # fmt: skip
    stood = Loaded(
        ticks=0, product=0.0, square=0.0, sent_1=0.0, sent_2=0.0, moved_1=0.0, moved_2=0.0, stances=stances, mean=mean
    )
    return DriveMotion(
        applied=before.applied, force=before.force, force_before=before.force_before, contact=contact, ticks=0,
        settled=0, flight_1=before.flight_1, flight_2=before.flight_2, stance=before.stance, compared_1=_NOTHING,
        compared_2=_NOTHING, loaded=stood, delays=_with_delay(before.delays), wrong=before.wrong, doubted=doubted,
    ), doubts  # fmt: skip


@as_written
def _restarted(before):
    """`DriveMotion` with empty filters."""
    return DriveMotion(
        applied=before.applied, force=before.force, force_before=before.force_before, contact=before.contact,
        ticks=before.ticks, settled=0, flight_1=before.flight_1, flight_2=before.flight_2, stance=before.stance,
        compared_1=_NOTHING, compared_2=_NOTHING, loaded=before.loaded, delays=before.delays, wrong=before.wrong,
        doubted=before.doubted,
    )  # fmt: skip


@as_written
def _disobedience(sent_1, sent_2, moved_1, moved_2):
    """`Disobedience` for torques in directions 1 and 2 [N·m], and the drives that are the cause."""
    off_1 = abs(moved_1 - sent_1 + moved_2 - sent_2)
    off_2 = abs(moved_1 - sent_1 - moved_2 + sent_2)
    doubts = _MOTOR_1 | _MOTOR_2
    if off_1 > ALONE * off_2:
        doubts = _MOTOR_1
    elif off_2 > ALONE * off_1:
        doubts = _MOTOR_2
    return Disobedience(
        sent_1=0.5 * (sent_1 + sent_2), sent_2=0.5 * (sent_1 - sent_2), moved_1=0.5 * (moved_1 + moved_2),
        moved_2=0.5 * (moved_1 - moved_2),
    ), doubts  # fmt: skip


@as_written
def _compared(settings, state, drives, motion, inputs):
    """`DriveMotion` with this tick's torques in the filters and, in stance, in the sums."""
    tick = settings.sensor_model.tick
    grounded = drives.contact == _STANCE
    moved_1, moved_2, k = _moving_torques(settings.masses, state.rates, tick, motion, drives.force, grounded)
    past = drives.applied
    mean_1 = 0.5 * (past.latest_1 + past.before_1)
    mean_2 = 0.5 * (past.latest_2 + past.before_2)
    quick = tick / (FILTER_TIME + tick)
    slow = tick / (SIDEWAYS_TIME + tick) if grounded else quick
    sent_1 = mean_1 + mean_2
    compared_1 = _filtered(drives.compared_1, slow, moved_1, sent_1)
    compared_2 = _filtered(drives.compared_2, quick, moved_2 - k * moved_1, mean_1 - mean_2 - k * sent_1)
    loaded = drives.loaded
    delays = drives.delays
    if not grounded and drives.settled >= _LEARNED_FROM and loaded.stances < LEARNING_STANCES:
        delays = _delays(delays, compared_2)
    if grounded and drives.ticks >= LOADED_FROM and drives.settled >= _JUDGED_FROM + delays.delay:
        sent_2 = _delayed(compared_2, delays.delay)
        loaded = Loaded(
            ticks=loaded.ticks + 1, product=loaded.product + compared_2.moved * sent_2,
            square=loaded.square + sent_2 * sent_2, sent_1=loaded.sent_1 + compared_1.sent,
            sent_2=loaded.sent_2 + sent_2, moved_1=loaded.moved_1 + compared_1.moved,
            moved_2=loaded.moved_2 + compared_2.moved, stances=loaded.stances, mean=loaded.mean,
        )  # fmt: skip
    return DriveMotion(
        applied=past, force=drives.force, force_before=drives.force_before, contact=drives.contact,
        ticks=drives.ticks + 1, settled=drives.settled + 1, flight_1=drives.flight_1, flight_2=drives.flight_2,
        stance=drives.stance, compared_1=compared_1, compared_2=compared_2, loaded=loaded, delays=delays,
        wrong=drives.wrong, doubted=drives.doubted,
    )  # fmt: skip


@as_written
def _filtered(before, weight, moved, sent):
    return Compared(
        moved=before.moved + weight * (moved - before.moved), sent=before.sent + weight * (sent - before.sent),
        sent_1=before.sent, sent_2=before.sent_1, sent_3=before.sent_2,
    )  # fmt: skip


@as_written
def _delays(sums, compared):
    """`Delays` with the torques of another tick."""
    return Delays(
        product_0=sums.product_0 + compared.moved * compared.sent,
        product_1=sums.product_1 + compared.moved * compared.sent_1,
        product_2=sums.product_2 + compared.moved * compared.sent_2,
        product_3=sums.product_3 + compared.moved * compared.sent_3,
        square_0=sums.square_0 + compared.sent * compared.sent,
        square_1=sums.square_1 + compared.sent_1 * compared.sent_1,
        square_2=sums.square_2 + compared.sent_2 * compared.sent_2,
        square_3=sums.square_3 + compared.sent_3 * compared.sent_3,
        delay=sums.delay,
    )


@as_written
def _with_delay(sums):
    """`Delays` with the delay by which the least squares of the motion are least, that is Σ² product / square most."""
    most = 0.0
    delay = sums.delay
    for tried, product, square in (
        (0, sums.product_0, sums.square_0), (1, sums.product_1, sums.square_1), (2, sums.product_2, sums.square_2),
        (_MOST_DELAY, sums.product_3, sums.square_3),
    ):  # fmt: skip
        if product > 0.0 and product * product > most * square:
            most = product * product / square
            delay = tried
    return Delays(
        product_0=sums.product_0, product_1=sums.product_1, product_2=sums.product_2, product_3=sums.product_3,
        square_0=sums.square_0, square_1=sums.square_1, square_2=sums.square_2, square_3=sums.square_3, delay=delay,
    )  # fmt: skip


@as_written
def _delayed(compared, delay):
    """Command in one direction that acts now [N·m]."""
    if delay == 0:
        return compared.sent
    if delay == 1:
        return compared.sent_1
    return compared.sent_2 if delay == 2 else compared.sent_3


@compiled
def _moving_torques(masses, rates, tick, motion, force, grounded):
    """Torques Q₁ and Q₂ that the acceleration at the reading before needs [N·m], and k; k = 0 in flight.

    The hip's accelerations follow from the forces on the foot; in stance the horizontal one from the foot at rest.
    """
    acc_1 = (motion.alpha_1 - 2.0 * rates.alpha_1 + rates.alpha_1_before) / (tick * tick)
    acc_2 = (motion.alpha_2 - 2.0 * rates.alpha_2 + rates.alpha_2_before) / (tick * tick)
    rate_1 = 0.5 * (motion.alpha_1 - rates.alpha_1_before) / tick
    rate_2 = 0.5 * (motion.alpha_2 - rates.alpha_2_before) / tick
    bar = four_bar(masses.leg, rates.alpha_2)
    toe = foot(masses.leg, bar, rates.alpha_1)
    m = terms(masses, bar, rates.alpha_1, rates.alpha_2, rate_1, rate_2)
    swing = m.x_1 * acc_1 + m.x_2 * acc_2 + m.n_x
    acc_x = -swing / m.x
    force_x = 0.0
    k = 0.0
    if grounded:
        centripetal = 2.0 * toe.x_12 * rate_1 * rate_2 + toe.x_22 * rate_2 * rate_2 - toe.x * rate_1 * rate_1
        pinned = swing - m.x * (centripetal + toe.x_1 * acc_1 + toe.x_2 * acc_2)
        force_x = min(max(pinned, -GRIP * force), GRIP * force)
        acc_x = (force_x - swing) / m.x
        k = toe.x_2 / toe.x_1
    acc_y = (force - m.n_y - m.y_1 * acc_1 - m.y_2 * acc_2) / m.y
    moved_1 = m.x_1 * acc_x + m.y_1 * acc_y + m.a * acc_1 + m.n_1 - toe.x_1 * force_x - toe.y_1 * force
    moved_2 = m.x_2 * acc_x + m.y_2 * acc_y + m.d * acc_2 + m.n_2 - toe.x_2 * force_x - toe.y_2 * force
    return moved_1, moved_2, k


@as_written
def _judged(limit, wrong_ticks, drives):
    """`DriveMotion` after the comparison, from which it learns, and the drives to doubt."""
    learns = drives.loaded.stances < LEARNING_STANCES
    moved_1 = drives.compared_1.moved
    moved_2 = drives.compared_2.moved
    sent_1 = _delayed(drives.compared_1, drives.delays.delay)
    sent_2 = _delayed(drives.compared_2, drives.delays.delay)
    flight_1 = drives.flight_1
    flight_2 = drives.flight_2
    stance = drives.stance
    if drives.contact == _FLIGHT:
        off_1 = moved_1 / flight_1.gain - sent_1
        off_2 = moved_2 / flight_2.gain - sent_2
        most = max(flight_1.most, flight_2.most)
        ratio = max(_excess(most, sent_1, off_1, limit, learns), _excess(most, sent_2, off_2, limit, learns))
        if drives.settled >= _LEARNED_FROM:
            flight_1 = _learned(flight_1, sent_1, off_1, limit, learns)
            flight_2 = _learned(flight_2, sent_2, off_2, limit, learns)
    else:
        off_1 = moved_1 / stance.gain - sent_1
        off_2 = moved_2 / stance.gain - sent_2
        ratio = _excess(stance.most, sent_2, off_2, limit, learns)
        if drives.settled >= _LEARNED_FROM:
            stance = _learned(stance, sent_2, off_2, limit, learns)
    wrong = drives.wrong
    if drives.settled >= _JUDGED_FROM + drives.delays.delay:
        wrong = wrong + min(int(ratio), _CLEARLY) if ratio > 1.0 else 0
    doubted = drives.doubted
    doubts = 0
    if wrong >= wrong_ticks:
        doubted, doubts = _disobedience(sent_1, sent_2, sent_1 + off_1, sent_2 + off_2)
    return DriveMotion(
        applied=drives.applied, force=drives.force, force_before=drives.force_before, contact=drives.contact,
        ticks=drives.ticks, settled=drives.settled, flight_1=flight_1, flight_2=flight_2, stance=stance,
        compared_1=drives.compared_1, compared_2=drives.compared_2, loaded=drives.loaded, delays=drives.delays,
        wrong=wrong, doubted=doubted,
    ), doubts  # fmt: skip


@as_written
def _excess(most, sent, off, limit, learns):
    """Deviation of the motion in one direction as a multiple of the largest one allowed."""
    if learns:
        return abs(off) / (_FIRST_BOUND * limit + _FIRST_SHARE * abs(sent))
    return abs(off) / (max(limit, _MARGIN * most) + _SHARE * abs(sent))


@as_written
def _learned(follows, sent, off, limit, learns):
    """`Follows` after a step of normalised least mean squares."""
    step = (_FAST if learns else _SLOW) * follows.gain * off * sent / (sent * sent + 1.0)
    most = follows.most
    if learns:
        most = min(max(most, abs(off) - _SHARE * abs(sent)), _MOST_LEARNED * limit)
    return Follows(gain=min(max(follows.gain + step, _LEAST_GAIN), _MOST_GAIN), most=most)

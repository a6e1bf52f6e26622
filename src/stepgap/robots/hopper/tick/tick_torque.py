"""Torques requested in each mode of a tick, from the laws of `joint_control`."""

import numpy as np

from stepgap.base.compiled import as_written, compiled
from stepgap.plants.tick_control import Mode
from stepgap.robots.hopper.model.joint_control import flight_torque, stance_torque
from stepgap.robots.hopper.model.leg import foot, four_bar
from stepgap.robots.hopper.tick.estimator import mean_speed
from stepgap.robots.hopper.tick.phases import Phase

LANDING_DAMPING = 0.5
"""Damping of each motor in the last landing [N·m·s/rad]; gives one more bounce, no harder than a hop."""


@as_written
def wanted_torque(law, phase, motion, flight, hop, inputs):
    """Torques requested by the law of the mode [N·m]."""
    if inputs.mode == Mode.TORQUE:
        return inputs.force_x, inputs.force_y
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
    speed = mean_speed(flight.fit)
    if np.isnan(speed):
        speed = flight.last_speed
    return flight_torque(law, motion.alpha_1, motion.alpha_2, motion.rate_1, motion.rate_2, speed)


@as_written
def _landing_torque(law, motion, share):
    """Torques that end the hopping on the ground [N·m]: a damped spring whose stiffness fades to zero."""
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


@compiled
def lost_force(law, alpha_1, alpha_2, lost_1, lost_2):
    """Force on the body that torques (lost_1, lost_2) cause in stance: the inverse of τ = −Jᵀ force."""
    toe = foot(law.leg, four_bar(law.leg, alpha_2), alpha_1)
    q_1 = lost_1 + lost_2
    q_2 = lost_1 - lost_2
    determinant = toe.x_1 * toe.y_2 - toe.x_2 * toe.y_1
    return (toe.y_1 * q_2 - toe.y_2 * q_1) / determinant, (toe.x_2 * q_1 - toe.x_1 * q_2) / determinant

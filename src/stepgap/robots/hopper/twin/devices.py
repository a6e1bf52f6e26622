"""The twin's encoders, motors and moving ground, compiled, over views of MuJoCo's memory."""

from typing import NamedTuple

import numpy as np

from stepgap.base.compiled import as_written
from stepgap.robots.hopper.twin.drives import command
from stepgap.robots.hopper.twin.treads import (
    UnevenViews,
    move_riser,
    put_on_tread,
    tilt_ground,
    tread_height,
    tread_under,
)
from stepgap.step import Array

READ = 0
OUT_OF_REACH = 1
TOO_FAST = 2
"""Outcomes of a reading."""


class Devices(NamedTuple):
    """Constants of sensors and motors.

    Attributes:
        motor_1: Index of motor 1 among MuJoCo's coordinates.
        motor_2: Index of motor 2.
        offset_1: Offset of encoder 1, reading minus true angle [rad].
        offset_2: Offset of encoder 2, reading minus true angle [rad].
        motor_scale: Counts per radian of the motor encoders.
        yaw_scale: Counts per radian of the yaw encoder.
        pitch_scale: Counts per radian of the pitch encoder.
        motors_round: Whether the motor encoders give integer counts.
        yaw_rounds: Whether the yaw encoder gives integer counts.
        pitch_rounds: Whether the pitch encoder gives integer counts.
        overspeed: Motor speed at which the drives trip [rad/s].
        boom_arc: Whether the hip moves on a sphere about the boom's pivot, not in a plane.
        boom_elastic: Whether the boom's tip can move against its root.
        boom_length: Distance from pivot to hip [m].
        pivot_height: Height of the pivot above the ground [m].
        floor_yaw: Angle by which the floor is turned under the robot [rad].
        torque_limit: Largest torque of the drives [N·m].
        torque_saturation: Torque at which a motor's iron saturates [N·m].
        noise_kept: Fraction of a motor's torque noise that persists to the next tick.
        noise_fresh: Standard deviation of the noise added at each tick [N·m].
        delay: Delay of the drives [ticks].
        lag: Time constant of their lag [ticks].
        tick: Time from one read to the next [s].
        reach: How far the foot may come in a tick [m].
        steepness: Steepest rise of the ground, over length.
    """

    motor_1: int
    motor_2: int
    offset_1: float
    offset_2: float
    motor_scale: float
    yaw_scale: float
    pitch_scale: float
    motors_round: bool
    yaw_rounds: bool
    pitch_rounds: bool
    overspeed: float
    boom_arc: bool
    boom_elastic: bool
    boom_length: float
    pivot_height: float
    floor_yaw: float
    torque_limit: float
    torque_saturation: float
    noise_kept: float
    noise_fresh: float
    delay: float
    lag: float
    tick: float
    reach: float
    steepness: float


class Views(NamedTuple):
    """Views of MuJoCo's memory, because a look-up through its own interface takes 1 µs.

    Attributes:
        qpos: MuJoCo's coordinates.
        qvel: Their rates.
        touch: Contact force; shape (1,) [N].
        ctrl: Torques of the motors before their scales; shape (2,) [N·m].
        memory: What the drives remember, MuJoCo's `userdata`.
        force: External forces on the coordinates; those on the motors are the torque noise [N·m].
        foot: Position of the foot in MuJoCo's frame; shape (3,) [m].
        ground: Position of the ground; shape (3,) [m].
        waves: Wave number per turn, phase [rad] and amplitude [m] of each wave of the ground; shape (w, 3).
        uneven: Treads of the ground, and what is moved with them.
    """

    qpos: Array
    qvel: Array
    touch: Array
    ctrl: Array
    memory: Array
    force: Array
    foot: Array
    ground: Array
    waves: Array
    uneven: UnevenViews


@as_written
def read_counts(devices, views):
    """Returns the encoder counts of motors and boom, the contact force [N], and the outcome of the reading.

    Args:
        devices: Record of `Devices`.
        views: `Views`.
    """
    rig = devices[0]
    qpos = views.qpos
    qvel = views.qvel
    yaw, pitch = boom_angles(rig, qpos)
    motor_1 = (qpos[rig.motor_1] + rig.offset_1) * rig.motor_scale
    motor_2 = (qpos[rig.motor_2] + rig.offset_2) * rig.motor_scale
    yaw = yaw * rig.yaw_scale
    pitch = pitch * rig.pitch_scale
    outcome = READ
    if not np.isfinite(motor_1 + motor_2 + yaw + pitch):
        outcome = OUT_OF_REACH
    elif max(abs(qvel[rig.motor_1]), abs(qvel[rig.motor_2])) > rig.overspeed:
        outcome = TOO_FAST
    if rig.motors_round:
        motor_1 = np.rint(motor_1)
        motor_2 = np.rint(motor_2)
    if rig.yaw_rounds:
        yaw = np.rint(yaw)
    if rig.pitch_rounds:
        pitch = np.rint(pitch)
    return (motor_1, motor_2, yaw, pitch, views.touch[0]), outcome


@as_written
def boom_angles(devices, qpos):
    """Yaw and pitch at the boom's root [rad]; NaN outside of the boom's reach."""
    if devices.boom_arc:
        return qpos[0], qpos[1]
    sine = (qpos[1] - devices.pivot_height) / devices.boom_length
    return qpos[0] / devices.boom_length, np.arcsin(sine) if abs(sine) <= 1.0 else np.nan


@as_written
def drive(devices, torque_1, torque_2, noise, views):
    """Passes on the torques of a tick, their noise and, while the foot is in the air, the ground's height.

    Args:
        devices: Record of `Devices`.
        torque_1: Torque commanded to motor 1 [N·m].
        torque_2: Torque commanded to motor 2 [N·m].
        noise: A standard normal number for each motor; shape (2,).
        views: `Views`.

    Returns:
        The torques within the drives' limit [N·m]; NaN, and nothing passed on, if one is not finite.
    """
    rig = devices[0]
    force = views.force
    waves = views.waves
    if not (np.isfinite(torque_1) and np.isfinite(torque_2)):
        return np.nan, np.nan
    limit = rig.torque_limit
    torque_1 = min(max(torque_1, -limit), limit)
    torque_2 = min(max(torque_2, -limit), limit)
    command(rig, views.memory, _saturated(rig, torque_1), _saturated(rig, torque_2))
    force[rig.motor_1] = rig.noise_kept * force[rig.motor_1] + rig.noise_fresh * noise[0]
    force[rig.motor_2] = rig.noise_kept * force[rig.motor_2] + rig.noise_fresh * noise[1]
    if len(waves) > 0 and views.touch[0] == 0.0:
        views.ground[2] = ground_under(devices, views)
    return torque_1, torque_2


@as_written
def _saturated(devices, torque):
    """Torque that a motor with saturating iron gives for a command [N·m]."""
    most = devices.torque_saturation
    return most * np.tanh(torque / most) if most < np.inf else torque


@as_written
def ground_under(devices, views):
    """Height of the ground under the foot [m]; on treads, that of the tread on which it is, or to which it falls."""
    rig = devices[0]
    uneven = views.uneven
    yaw = _foot_yaw(rig, views.foot) + rig.floor_yaw
    height = _wave_height(views.waves, yaw)
    if len(uneven.treads) > 0:
        height += tread_height(uneven, int(uneven.under[0]), rig.boom_length * yaw)
    return height


@as_written
def in_flight(devices, views):
    """Whether the foot cannot come to the ground, nor to a riser, within a tick."""
    rig = devices[0]
    foot = views.foot
    uneven = views.uneven
    highest = views.ground[2]
    if len(uneven.treads) > 0:
        yaw = _foot_yaw(rig, foot) + rig.floor_yaw
        for side in range(-1, 2):
            place = rig.boom_length * yaw + side * rig.reach
            tread = tread_under(uneven, int(uneven.under[0]), place, np.inf)
            highest = max(highest, _wave_height(views.waves, yaw) + tread_height(uneven, tread, place))
    return foot[2] - highest > rig.reach * (1.0 + rig.steepness)


@as_written
def _foot_yaw(rig, foot):
    """Yaw of the boom at which the foot is in its middle plane [rad]."""
    return np.arctan2(foot[0], -foot[1]) if rig.boom_arc else foot[0] / rig.boom_length


@as_written
def _wave_height(waves, yaw):
    """Height of the waves of the ground at a yaw of the floor [m]."""
    height = 0.0
    for wave in range(len(waves)):
        height += waves[wave, 2] * np.sin(waves[wave, 0] * yaw + waves[wave, 1])
    return height


@as_written
def move_ground(devices, views):
    """Moves tread and riser under the foot, before a physics step on uneven ground.

    A foot on the ground stays on its tread until it lifts.
    """
    rig = devices[0]
    uneven = views.uneven
    foot = views.foot
    yaw = _foot_yaw(rig, foot)
    place = rig.boom_length * (yaw + rig.floor_yaw)
    height = foot[2] - _wave_height(views.waves, yaw + rig.floor_yaw)
    if views.touch[0] == 0.0:
        tread = tread_under(uneven, int(uneven.under[0]), place, height)
        if tread != uneven.under[0]:
            put_on_tread(uneven, tread)
        views.ground[0] = foot[0]
        views.ground[1] = foot[1]
        views.ground[2] = ground_under(devices, views)
        tilt_ground(uneven, yaw if rig.boom_arc else 0.0)
    if len(uneven.riser) > 0:
        move_riser(rig, uneven, foot, yaw, place, height)

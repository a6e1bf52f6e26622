"""Identification from every tick with MuJoCo's toolbox `mujoco.sysid`, which the extra `stepgap[sysid]` installs.

The nominal MuJoCo model is simulated with the recorded torques from shortly before a touchdown until after take-off.
Its parameters are fitted so that the hip moves as measured by the boom's encoders. Windows start from measured values.
The motion determines masses, inertias and torques only up to a common factor: if all are doubled, the motion is the
same. The priors fix this factor, and the map does not depend on it.
"""

# pyright: reportAttributeAccessIssue=false
# (MuJoCo ships no types for its compiled part.)

from collections.abc import Sequence
from contextlib import redirect_stdout
from dataclasses import replace
from io import StringIO
from math import tau
from typing import Any, NamedTuple

import mujoco
import numpy as np
from mujoco import sysid
from numpy.typing import NDArray

from benchmarks.learning.methods.physical_parameters import (
    PARAMETER_PRIOR_STD,
    AdjustedMap,
    PhysicalError,
    erring_robot,
    with_error,
)
from stepgap.robots.hopper.model.apex_map import ApexMap
from stepgap.robots.hopper.model.leg import foot, four_bar, knee_angle, leg_of
from stepgap.robots.hopper.parameters import RobotParameters
from stepgap.robots.hopper.tick.sensors import HopperSensorModel
from stepgap.robots.hopper.tick.tick_row import Tick
from stepgap.robots.hopper.twin.model import build_model
from stepgap.robots.hopper.twin.reality_gap import RealityGap
from stepgap.step import Array

HORIZONS = (60, 120, 250)
"""Numbers of ticks after touchdown that are compared, in successive fits. If a whole stance (100 to 150 ticks) and the
flight after it were one window, inaccurate parameters would move the leg through its singular stretched pose."""

BEFORE = 10
"""Number of ticks before touchdown that are compared; in a longer simulation, torques that hold a leg would move it."""

HIP_FIT, LEG_FIT = 150, 40
"""Numbers of ticks before touchdown to whose sensor values a parabola is fitted."""

TOUCHDOWN_MARGIN = 2
"""Number of the last of these ticks that are left out, because the foot may touch the ground before it is detected."""

WINDOWS = 28
"""Number of touchdowns of a deployment that are used."""

SUBSTEPS = 4
"""Physics steps per tick."""

SAMPLE = 5
"""Interval of the compared samples, in ticks."""

HIP_ERROR_SCALE = 0.005
"""Error of the hip's travel or height with the cost of a parameter one prior standard deviation off [m]."""

DIVERGED_COST = 100.0
"""Error of a motion that diverges [scaled errors]."""

SHARED = ("body_mass", "leg_mass", "boom_vertical", "boom_horizontal", "torque")
"""Parameters that are fields of `PhysicalError`."""

OFFSETS = {"motor_offset_1": 0.005, "motor_offset_2": 0.005}
"""Parameters that are fields of `RealityGap` with equivalents in `PhysicalError`; prior standard deviations [rad]."""

UNKNOWN = {"joint_friction": 0.05, "joint_damping": 0.005, "boom_friction": 0.5, "torque_lag": 0.002}
"""Parameters that are fields of `RealityGap` without equivalents in the physics model; prior standard deviations."""

PRIOR_STDS = {name: getattr(PARAMETER_PRIOR_STD, name) for name in SHARED} | OFFSETS | UNKNOWN

Values = dict[str, float]
"""Parameters by the names of PRIOR_STDS."""


class Windows(NamedTuple):
    """W windows of T ticks around a touchdown.

    Attributes:
        tick: Time from one tick to the next [s].
        start: Travel and height of the hip, motor angles, and their rates, at the first tick; shape (W, 2, 4) [m, rad].
        touchdown: Values at touchdown; shape (W, 4) [m, rad].
        torque: Applied torques; shape (W, T, 2) [N·m].
        hip: Travel and height of the hip after every `SAMPLE` ticks; shape (W, T / SAMPLE − 1, 2) [m].
    """

    tick: float
    start: Array
    touchdown: Array
    torque: Array
    hip: Array


def identify_from_ticks(nominal: ApexMap, ticks: Sequence[Tick], sensors: HopperSensorModel) -> AdjustedMap:
    """The physics model with parameters fitted to the recorded motion.

    Args:
        nominal: Map of the physics model.
        ticks: All ticks of a deployment with at least one step.
        sensors: Sensor model of the rig.
    """
    return with_error(nominal, physical_error(nominal, identify_values(nominal.robot, ticks, sensors)))


def physical_error(nominal: ApexMap, values: Values) -> PhysicalError:
    """Equivalent errors of the physics model; a motor's offset becomes another landing posture and rest length."""
    leg, gains = leg_of(nominal.robot), nominal.gains
    alpha_1, alpha_2 = _leg_angles(np.array([values[name] for name in OFFSETS]))
    length_error = -float(alpha_2) * four_bar(leg, knee_angle(leg, gains.landing_length)).d_length
    return PhysicalError(
        **{name: values[name] for name in SHARED},
        landing_speed=float(alpha_1) / gains.speed_gain,
        landing_length=length_error,
        rest_length=length_error,
    )


def identify_values(robot: RobotParameters, ticks: Sequence[Tick], sensors: HopperSensorModel) -> Values:
    """Parameters of the MuJoCo model, fitted by least squares with a weak prior."""
    found = sysid.ParameterDict()
    for name in PRIOR_STDS:
        range_ = (0.3, 0.05, 3.0) if name in UNKNOWN else (0.0, -3.0, 3.0)
        found.add(sysid.Parameter(name, *range_))
    for horizon in HORIZONS:
        windows = record_windows(ticks, sensors, horizon)

        def residuals(scaled: Array, parameters: Any, windows: Windows = windows) -> tuple[list[Array], None, None]:
            parameters.update_from_vector(scaled)
            return [errors(robot, windows, _values(parameters)), scaled], None, None

        with redirect_stdout(StringIO()):  # its optimiser has no option to print nothing
            found, _ = sysid.optimize(
                found.move_off_bounds(), residuals, "scipy", verbose=False, max_iters=15, diff_step=1e-2, ftol=1e-3
            )
    return _values(found)


def record_windows(ticks: Sequence[Tick], sensors: HopperSensorModel, horizon: int) -> Windows:
    """Windows that end `horizon` ticks after touchdown, spread evenly over the recording."""
    readings = np.array([tick.reading for tick in ticks], float)
    travel = sensors.boom_length * readings[:, 2] * tau / sensors.boom_counts_horizontal
    height = sensors.pivot_height + sensors.boom_length * np.sin(readings[:, 3] * tau / sensors.boom_counts_vertical)
    sensed = np.column_stack([travel, height, readings[:, :2] * tau / sensors.motor_counts])
    standing = readings[:, 4] > sensors.touchdown_force
    landings = np.array(
        [
            tick
            for tick in np.flatnonzero(np.diff(standing)) + 1
            if HIP_FIT <= tick <= len(ticks) - max(HORIZONS) and not standing[tick - HIP_FIT : tick].any()
        ]
    )
    landings = landings[np.linspace(0, len(landings) - 1, min(WINDOWS, len(landings))).round().astype(int)]
    within = landings[:, None] + np.arange(-BEFORE, horizon)
    starts = [
        _start(sensed[:, :2], landings, HIP_FIT, sensors.tick),
        _start(sensed[:, 2:], landings, LEG_FIT, sensors.tick),
    ]
    return Windows(
        tick=sensors.tick,
        start=np.concatenate(starts, axis=-1),
        touchdown=0.5 * (sensed[landings] + sensed[landings - 1]),  # touchdown was between two ticks
        torque=np.array([tick.applied for tick in ticks])[within],
        hip=sensed[within[:, SAMPLE::SAMPLE], :2],
    )


def _start(sensed: Array, landings: NDArray[np.intp], count: int, tick: float) -> Array:
    """Values and rates BEFORE ticks before landings, by parabolas fitted to `count` ticks; shape (W, 2, 2)."""
    before = np.arange(-count, -TOUCHDOWN_MARGIN)
    powers = np.vander((before + BEFORE) * tick, 3, increasing=True)
    return (np.linalg.pinv(powers) @ sensed[landings[:, None] + before])[:, :2]


def errors(robot: RobotParameters, windows: Windows, values: Values) -> Array:
    """Scaled errors of the hip's travel and height, model minus recording; flat array."""
    try:
        return sysid.model_residual(
            np.empty(0),
            sysid.ParameterDict(),
            lambda _: _model(robot, values, windows.tick / SUBSTEPS),
            _trajectories(robot, windows, values),
            modify_residual=_hip_errors,
            n_threads=1,
            resample_true=False,
        )[0]
    except ValueError:  # raised by the toolbox if the motion diverges
        return np.full(windows.hip.size, DIVERGED_COST)


def _model(robot: RobotParameters, values: Values, timestep: float) -> mujoco.MjModel:
    """The nominal MuJoCo model with these parameters, except the offsets."""
    error = PhysicalError(**{name: values[name] for name in SHARED}, landing_speed=0, landing_length=0, rest_length=0)
    friction = {name: values[name] for name in UNKNOWN}
    gap = replace(RealityGap.none(), torque_scale=1 + error.torque, **friction)
    return build_model(erring_robot(robot, error), gap, timestep)


def _trajectories(robot: RobotParameters, windows: Windows, values: Values) -> list[Any]:
    """Trajectories of the toolbox for the windows, with heights above the ground under the foot."""
    leg, offsets = leg_of(robot), np.array([values[name] for name in OFFSETS])
    touchdown = _leg_angles(windows.touchdown[:, 2:] - offsets)
    ground = windows.touchdown[:, 1] + foot(leg, four_bar(leg, touchdown[1]), touchdown[0]).y
    motor, motor_rate = windows.start[:, 0, 2:] - offsets, windows.start[:, 1, 2:]
    alpha_2, rate_2 = _leg_angles(motor)[1], _leg_angles(motor_rate)[1]
    bar = four_bar(leg, alpha_2)
    knee, knee_rate = alpha_2 + np.arcsin(bar.sin_beta), (1 + bar.d_beta) * rate_2
    travel, height = windows.start[:, 0, :2].T
    state = np.column_stack(
        [
            np.zeros(len(ground)),  # time, coordinates, rates, states of the torque lag
            *(travel, height - ground, motor[:, 0], -knee, motor[:, 1], knee),
            *(*windows.start[:, 1, :2].T, motor_rate[:, 0], -knee_rate, motor_rate[:, 1], knee_rate),
            *windows.torque[:, 0].T,
        ]
    )
    torque = np.repeat(windows.torque, SUBSTEPS, axis=1)
    times = np.arange(torque.shape[1]) * windows.tick / SUBSTEPS
    sampled = np.arange(1, windows.hip.shape[1] + 1) * SAMPLE * windows.tick
    hip = windows.hip - np.column_stack([np.zeros(len(ground)), ground])[:, None]
    return [
        sysid.SystemTrajectory(
            None, sysid.TimeSeries(times, torque[i]), sysid.TimeSeries(sampled, hip[i]), state[i], None
        )
        for i in range(len(state))
    ]


def _hip_errors(parameters: Any, sensors: Any, measured: Any, model: Any, everything: bool, state: Array) -> tuple:
    """Residual function of the toolbox: errors and the compared series; in states, time precedes the coordinates."""
    stride = SAMPLE * SUBSTEPS
    return (state[stride - 1 :: stride, 1:3] - measured.data) / HIP_ERROR_SCALE, measured, measured


def _leg_angles(motor: Array) -> Array:
    """Leg angles α₁, α₂ (2, …) of motor angles (…, 2)."""
    return np.array([0.5 * (motor[..., 0] + motor[..., 1]), 0.5 * (motor[..., 0] - motor[..., 1])])


def _values(parameters: Any) -> Values:
    """Values of parameters that are scaled by their prior standard deviations."""
    return {name: std * float(parameters[name].value[0]) for name, std in PRIOR_STDS.items()}

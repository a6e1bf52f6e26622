"""Identification from every tick with MuJoCo's toolbox `mujoco.sysid`, which the extra `stepgap[sysid]` installs.

The nominal MuJoCo model is rolled out under the recorded torques from shortly before a touchdown until after take-off,
and what is sought are the parameters with which the hip then moves as the boom's encoders say. A window starts from
what the sensors tell. Motion tells masses, inertias and torques only up to one common factor: doubled all together they
hop alike. The priors fix it, and the map does not depend on it.
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

from stepgap.bench.baselines import SPREAD, AdjustedMap, PhysicalError, erring_robot, with_error
from stepgap.robots.hopper.apex_map import ApexMap
from stepgap.robots.hopper.leg import foot, four_bar, knee_angle, leg_of
from stepgap.robots.hopper.parameters import RobotParameters
from stepgap.robots.hopper.sensors import HopperSensorModel
from stepgap.robots.hopper.tick import Tick
from stepgap.robots.hopper.twin.model import build_model
from stepgap.robots.hopper.twin.reality_gap import RealityGap
from stepgap.step import Array

HORIZONS = (60, 120, 250)
"""Ticks compared after touchdown, one fit after the other: parameters far off would send the leg through its singular
stretch if all of a stance (100 to 150 ticks) and the flight after it were compared at once."""

BEFORE = 10
"""Ticks compared before touchdown: torques that hold a leg at rest, rolled out for longer, would move it."""

HIP_FIT, LEG_FIT = 150, 40
"""Ticks before touchdown to whose sensor values a parabola is fitted."""

TOUCHDOWN_MARGIN = 2
"""Of these, the last ones that are left out: the foot may touch the ground before that is noticed."""

WINDOWS = 28
"""Touchdowns of a deployment that are used."""

SUBSTEPS = 4
"""Physics steps in a tick."""

SAMPLE = 5
"""Ticks from one error that counts to the next."""

HIP_MISFIT = 0.005
"""Error of the hip's travel or height that costs as much as a parameter one spread from its nominal value [m]."""

DIVERGED_COST = 100.0
"""Errors of a motion that diverges [misfits]."""

SHARED = ("body_mass", "leg_mass", "boom_vertical", "boom_horizontal", "torque")
"""Parameters that are fields of `PhysicalError`."""

OFFSETS = {"motor_offset_1": 0.005, "motor_offset_2": 0.005}
"""Parameters that are fields of `RealityGap` and that `PhysicalError` says in other words; spreads of priors [rad]."""

UNKNOWN = {"joint_friction": 0.05, "joint_damping": 0.005, "boom_friction": 0.5, "torque_lag": 0.002}
"""Parameters that are fields of `RealityGap` and that the physics model has no word for; spreads of their priors."""

SPREADS = {name: getattr(SPREAD, name) for name in SHARED} | OFFSETS | UNKNOWN

Values = dict[str, float]
"""Parameters by the names of SPREADS."""


class Windows(NamedTuple):
    """W stretches of T ticks about a touchdown.

    Attributes:
        tick: Time from one tick to the next [s].
        start: Travel and height of the hip, motor angles, and the rates of all, at the first; shape (W, 2, 4) [m, rad].
        touchdown: Values then; shape (W, 4) [m, rad].
        torque: Applied; shape (W, T, 2) [N·m].
        hip: Travel and height after each `SAMPLE` ticks; shape (W, T / SAMPLE − 1, 2) [m].
    """

    tick: float
    start: Array
    touchdown: Array
    torque: Array
    hip: Array


def identify_from_ticks(nominal: ApexMap, ticks: Sequence[Tick], layout: HopperSensorModel) -> AdjustedMap:
    """The physics model with the parameters that explain the recorded motion best.

    Args:
        nominal: Map of the physics model.
        ticks: All of a deployment with at least one step.
        layout: Of the rig.
    """
    return with_error(nominal, physical_error(nominal, identify_values(nominal.robot, ticks, layout)))


def physical_error(nominal: ApexMap, values: Values) -> PhysicalError:
    """In words of the physics model, where a motor's offset is another landing posture and another rest length."""
    leg, gains = leg_of(nominal.robot), nominal.gains
    lean, fold = _leg_angles(np.array([values[name] for name in OFFSETS]))
    shorter = -float(fold) * four_bar(leg, knee_angle(leg, gains.landing_length)).d_length
    return PhysicalError(
        **{name: values[name] for name in SHARED},
        landing_speed=float(lean) / gains.speed_gain,
        landing_length=shorter,
        rest_length=shorter,
    )


def identify_values(robot: RobotParameters, ticks: Sequence[Tick], layout: HopperSensorModel) -> Values:
    """The parameters of the MuJoCo model: least squares with a weak prior."""
    found = sysid.ParameterDict()
    for name in SPREADS:
        range_ = (0.3, 0.05, 3.0) if name in UNKNOWN else (0.0, -3.0, 3.0)
        found.add(sysid.Parameter(name, *range_))
    for horizon in HORIZONS:
        windows = record_windows(ticks, layout, horizon)

        def misfit(shares: Array, parameters: Any, windows: Windows = windows) -> tuple[list[Array], None, None]:
            parameters.update_from_vector(shares)
            return [errors(robot, windows, _values(parameters)), shares], None, None

        with redirect_stdout(StringIO()):  # its optimiser cannot be told to be silent
            found, _ = sysid.optimize(
                found.move_off_bounds(), misfit, "scipy", verbose=False, max_iters=15, diff_step=1e-2, ftol=1e-3
            )
    return _values(found)


def record_windows(ticks: Sequence[Tick], layout: HopperSensorModel, horizon: int) -> Windows:
    """Windows that end so many ticks after touchdown, spread evenly over the recording."""
    readings = np.array([tick.reading for tick in ticks], float)
    travel = layout.boom_length * readings[:, 2] * tau / layout.boom_counts_horizontal
    height = layout.pivot_height + layout.boom_length * np.sin(readings[:, 3] * tau / layout.boom_counts_vertical)
    sensed = np.column_stack([travel, height, readings[:, :2] * tau / layout.motor_counts])
    standing = readings[:, 4] > layout.touchdown_force
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
        _start(sensed[:, :2], landings, HIP_FIT, layout.tick),
        _start(sensed[:, 2:], landings, LEG_FIT, layout.tick),
    ]
    return Windows(
        tick=layout.tick,
        start=np.concatenate(starts, axis=-1),
        touchdown=0.5 * (sensed[landings] + sensed[landings - 1]),  # it happened between two ticks
        torque=np.array([tick.applied for tick in ticks])[within],
        hip=sensed[within[:, SAMPLE::SAMPLE], :2],
    )


def _start(sensed: Array, landings: NDArray[np.intp], count: int, tick: float) -> Array:
    """Values and rates BEFORE ticks before landings, by parabolas through the `count` ticks before; shape (W, 2, 2)."""
    before = np.arange(-count, -TOUCHDOWN_MARGIN)
    powers = np.vander((before + BEFORE) * tick, 3, increasing=True)
    return (np.linalg.pinv(powers) @ sensed[landings[:, None] + before])[:, :2]


def errors(robot: RobotParameters, windows: Windows, values: Values) -> Array:
    """Travel and height of the hip, model less recording, in misfits; flat."""
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
    except ValueError:  # so the toolbox takes a motion that diverges
        return np.full(windows.hip.size, DIVERGED_COST)


def _model(robot: RobotParameters, values: Values, timestep: float) -> mujoco.MjModel:
    """The nominal MuJoCo model but for these parameters; offsets are no part of it."""
    error = PhysicalError(**{name: values[name] for name in SHARED}, landing_speed=0, landing_length=0, rest_length=0)
    friction = {name: values[name] for name in UNKNOWN}
    gap = replace(RealityGap.none(), torque_scale=1 + error.torque, **friction)
    return build_model(erring_robot(robot, error), gap, timestep)


def _trajectories(robot: RobotParameters, windows: Windows, values: Values) -> list[Any]:
    """The windows as the toolbox takes them, heights from the ground under the foot on."""
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
            np.zeros(len(ground)),  # time, coordinates, rates, torques on their way through the lag
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
    """What the toolbox asks for: errors and what they are between; states have the time before the coordinates."""
    stride = SAMPLE * SUBSTEPS
    return (state[stride - 1 :: stride, 1:3] - measured.data) / HIP_MISFIT, measured, measured


def _leg_angles(motor: Array) -> Array:
    """Leg angles α₁, α₂ (2, …) of motor angles (…, 2)."""
    return np.array([0.5 * (motor[..., 0] + motor[..., 1]), 0.5 * (motor[..., 0] - motor[..., 1])])


def _values(parameters: Any) -> Values:
    """Parameters of shares of their spreads."""
    return {name: spread * float(parameters[name].value[0]) for name, spread in SPREADS.items()}

"""Time that MuJoCo needs for the physics steps of one hop, and the difference of the twin from the model.

MuJoCo has another contact model: a soft constraint on the foot in place of an impact. Only `mj_step` is timed, for the
number of 1 ms steps in a hop, while the robot falls with limp motors: no controller, no sensors. The difference is that
of the twin without a gap, whose controller holds torques for 1 ms and whose physics takes steps of a quarter of that.
"""

# pyright: reportAttributeAccessIssue=false
# (MuJoCo ships no types for its compiled part.)

from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np

from stepgap.plants.compiled_rig import Rows
from stepgap.plants.rig_plant import RigPlant
from stepgap.robots.hopper.parameters import CommandBounds, Gains, RobotParameters
from stepgap.robots.hopper.tick.hop_control import HopperControl
from stepgap.robots.hopper.twin.model import build_model
from stepgap.robots.hopper.twin.reality_gap import RealityGap
from stepgap.robots.hopper.twin.twin import Twin
from stepgap.step import Array, StepMap

STEP = 1e-3
"""Physics step that is timed [s]."""


def measure_twin(nominal: StepMap, robot: RobotParameters, gains: Gains, hops: int) -> tuple[int, Array]:
    """Median number of ticks of a hop, and the largest relative error of the next state; shape (n,)."""
    ticks, errors, rng = [0], [], np.random.default_rng(1)
    twin, bounds = Twin(robot, RealityGap.none(), rng, tick=STEP), CommandBounds()

    def count(rows: Rows, _step: int) -> None:
        ticks[-1] += len(rows)

    with RigPlant(twin, HopperControl(robot, gains, bounds), on_ticks=count) as plant:
        state = plant.start()
        for _ in range(hops):
            ticks.append(0)
            record = plant.take_step(rng.uniform([-8, -14], [2, -6]))
            expected = nominal(state, record.applied)
            scale = np.maximum(np.abs(expected), nominal.space.state_scale)
            errors.append((record.next_state - expected) / scale)
            state = record.next_state
    return int(np.median(ticks[1:])), np.abs(errors).max(axis=0)


def make_stepper(robot: RobotParameters, steps: int) -> Callable[[Any, Any], None]:
    """Makes a function that takes the physics steps of a hop; it ignores its arguments."""
    gap = RealityGap.none()
    twin = Twin(robot, gap, np.random.default_rng(0), tick=STEP)
    twin.connect()
    start = twin.true_state().qpos
    model = build_model(robot, gap, STEP)
    data = mujoco.MjData(model)
    held = [index for index in range(model.neq) if model.eq(index).name.startswith("hold_")]

    def step(_state: Any, _command: Any) -> None:
        mujoco.mj_resetData(model, data)
        data.qpos[:] = start
        data.eq_active[held] = 0
        mujoco.mj_step(model, data, nstep=steps)
        if not np.isfinite(data.qpos).all():
            raise FloatingPointError("MuJoCo diverged")

    return step

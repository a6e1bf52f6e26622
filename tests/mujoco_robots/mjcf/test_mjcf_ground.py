"""Ground of boxes against rays; what feet find on it; and that a command of the touchdown acts."""

# pyright: reportAttributeAccessIssue=false, reportPrivateUsage=false

from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np
import pytest

from stepgap.mujoco_robots.mjcf.mjcf_ground import GROUND_LENGTH, BoxGround, Footholds, above_ground
from stepgap.mujoco_robots.mjcf.mjcf_robot import MjcfPlant, MjcfSimulation
from stepgap.mujoco_robots.quadruped.robot import SPACE, Quadruped
from stepgap.plants.plant import Touchdown
from stepgap.robots.ground import FLAT_GROUND, UnevenGround
from stepgap.step import Array, StepRecord

BALL = """
<mujoco><option timestep="0.001"/><worldbody>
  <geom name="floor" type="plane" size="0.1 0.1 1" friction="0.6"/>
  <body name="ball" pos="0 0 1"><joint name="x" type="slide" axis="1 0 0"/><joint name="z" type="slide" axis="0 0 1"/>
    <geom name="foot" type="sphere" size="0.1" mass="2" friction="0.8"/></body>
</worldbody></mujoco>
"""
HILLS = UnevenGround(stair_height=0.05, slope=0.1, roughness=0.01)
MEASURED = UnevenGround(measured_heights=True)


def boxes(ground: UnevenGround) -> tuple[BoxGround, Any]:
    found = BoxGround(mujoco.MjSpec.from_string(BALL), ["foot"], ground.treads(GROUND_LENGTH, np.random.default_rng(5)))
    return found, mujoco.MjData(found.model)


def height_by_ray(model: Any, data: Any, x: float) -> float:
    down, hit = np.array([0.0, 0.0, -1.0]), np.zeros(1, np.int32)
    return 5 - mujoco.mj_ray(model, data, np.array([x, 1.0, 5.0]), down, None, 1, 1, hit)


def plant_on(ground: UnevenGround, seed: int = 3) -> MjcfPlant:
    return MjcfSimulation(Quadruped(ground=ground), np.random.default_rng(7)).plant(np.random.default_rng(seed))


def hops(plant: MjcfPlant, count: int, choose: Callable[[Touchdown], Array]) -> list[StepRecord]:
    plant.start()
    return [plant.take_replanned_step(np.zeros(2), choose) for _ in range(count)]


@pytest.mark.parametrize("robot_at", [0.0, 7.3, -40.1, 100.0])
def test_boxes_are_as_high_as_the_ground_wherever_the_robot_is(robot_at: float) -> None:
    ground, data = boxes(HILLS)
    start = 11.6
    data.qpos[0] = robot_at
    mujoco.mj_forward(ground.model, data)
    ground.put(data, start)
    data.qpos[1] = 20  # away from the rays
    mujoco.mj_forward(ground.model, data)
    for x in robot_at + np.linspace(-0.7, 0.7, 29):
        near = [ground.height(start + x + side) for side in np.linspace(-0.015, 0.015, 31)]  # risers lean by the slope
        height = height_by_ray(ground.model, data, x) + ground.height(start)
        assert min(near) - 1e-3 < height < max(near) + 1e-3


def test_a_softer_patch_yields_more_and_a_slippery_one_has_less_friction() -> None:
    depths = []
    for stiffness in (1.0, 0.25):
        ground, data = boxes(UnevenGround(patch_stiffness=stiffness, patch_friction=0.5, patch_length=1.0))
        ground.model.opt.gravity[:] = 0, 0, -9.81
        data.qpos[0] = 1.5  # on the second patch
        mujoco.mj_forward(ground.model, data)
        ground.put(data, 0.0)
        data.qpos[1] = -0.9
        mujoco.mj_step(ground.model, data, 3000)
        depths.append(-0.9 - data.qpos[1])
        assert data.contact.friction[0, 0] == pytest.approx(0.5 * 0.8)
    assert depths[1] / depths[0] == pytest.approx(4, rel=0.25)


def test_only_a_measured_height_is_above_the_ground() -> None:
    assert above_ground(SPACE, FLAT_GROUND) is SPACE
    speed, height = above_ground(SPACE, MEASURED).state
    assert (speed.above, height.above) == ("", "ground")
    with pytest.raises(ValueError, match="feet"):
        Footholds(boxes(MEASURED)[0].model, ())


def test_feet_find_ground_and_slope_of_a_ramp() -> None:
    plant = plant_on(UnevenGround(slope=0.05, ramp_length=6.0))
    ground = plant._stepper._ground
    found = hops(plant, 8, lambda touchdown: np.array([10.0, 20.0]))
    begin = plant._stepper._begin
    assert ground is not None
    for record in found[1:]:
        place = begin + record.context["foothold"]
        assert record.context["ground"] == pytest.approx(ground.height(place) - ground.height(begin), abs=0.004)
        ends = [ground.height(place + side) for side in (-0.5, 0.5)]
        if abs(abs(ends[1] - ends[0]) - 0.05) < 1e-9:  # one ramp under all feet of both steps
            assert abs(record.context["slope"]) == pytest.approx(0.05, abs=0.006)


def test_the_state_is_above_the_ground_of_its_step() -> None:
    measured, plain = (hops(plant_on(each), 4, lambda touchdown: np.zeros(2)) for each in (MEASURED, FLAT_GROUND))
    for above, fixed in zip(measured, plain, strict=True):
        ground = np.array([0, above.context["ground"]])
        np.testing.assert_allclose(
            [above.state, above.next_state], [s - ground for s in (fixed.state, fixed.next_state)]
        )
        assert abs(above.context["ground"]) < 0.003


def test_a_command_of_the_touchdown_acts_and_is_recorded() -> None:
    seen = list[Touchdown]()

    def higher(found: Touchdown) -> Array:
        seen.append(found)
        return np.array([0.0, 50.0])

    (planned,) = hops(plant_on(MEASURED), 1, higher)
    (first,) = hops(plant_on(MEASURED), 1, lambda found: np.zeros(2))
    plant = plant_on(MEASURED)
    plant.start()
    from_the_start = plant.take_step(np.array([0.0, 50.0]))
    np.testing.assert_array_equal(planned.command, [0, 50])
    np.testing.assert_array_equal(planned.state, seen[0].state)
    np.testing.assert_array_equal(planned.next_state, from_the_start.next_state)  # it acts from mid-stance on
    assert planned.next_state[1] - first.next_state[1] > 0.01
    assert len(seen) == 1
    assert abs(seen[0].context["slope"]) < 0.01

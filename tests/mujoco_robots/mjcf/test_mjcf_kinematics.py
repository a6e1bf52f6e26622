"""The drawn points of a MuJoCo model against MuJoCo's own positions, in a model with every kind of geom and joint."""

# pyright: reportAttributeAccessIssue=false

from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
import pytest

from stepgap.mujoco_robots.mjcf.mjcf_kinematics import MjcfKinematics, tick_row, tick_units
from stepgap.mujoco_robots.mjcf.mjcf_robot import ControlLaw, MjcfPlant, MjcfRobot
from stepgap.mujoco_robots.mjcf.section import Section, touchdown
from stepgap.plants.ticks.tick_table import TickTable
from stepgap.step import Array, Quantity, StepSpace

XML = """
<mujoco><worldbody>
  <geom name="floor" type="plane" size="9 9 1"/>
  <body name="trunk" pos="0 0 0.8"><freejoint name="root"/>
    <geom name="box" type="box" size="0.1 0.3 0.05" pos="0.02 0 0" mass="2"/>
    <geom name="shown_elsewhere" type="sphere" size="0.5" group="3" mass="0" contype="0" conaffinity="0"/>
    <body name="leg" pos="0.1 0 0"><joint name="hip" axis="0 1 0"/>
      <geom name="thigh" type="cylinder" size="0.02 0.2" pos="0 0 -0.2" mass="1" contype="0" conaffinity="0"/>
      <body name="shank" pos="0 0 -0.4"><joint name="knee" type="slide" axis="0 0 1"/>
        <geom name="rod" type="capsule" fromto="0 0 0 0.1 0 -0.3" size="0.03" mass="0.5"/>
        <geom name="foot" type="sphere" size="0.04" pos="0.1 0 -0.3" mass="0.1"/>
      </body></body></body></worldbody>
  <actuator><motor name="hip" joint="hip"/><motor joint="knee"/></actuator></mujoco>
"""


@dataclass(frozen=True)
class Tumbler(MjcfRobot):
    """Falls to the ground, whatever its command."""

    name = "tumbler"

    @property
    def space(self) -> StepSpace:
        return StepSpace((Quantity("height", "m", 0.8, 1.0),), (Quantity("push", "", -0.1, 0.1),))

    def mjcf_model(self) -> Any:
        return mujoco.MjModel.from_xml_string(XML)

    def controller(self) -> ControlLaw:
        return lambda model, data, command: data.ctrl.fill(float(command[0]))

    def section(self) -> Section:
        return touchdown("foot")

    def state(self, model: Any, data: Any) -> Array:  # noqa: ARG002
        return data.qpos[2:3].copy()

    def place(self, model: Any, data: Any, state: Array) -> None:  # noqa: ARG002
        data.qpos[2] = state[0]


def at(kinematics: Any, positions: Array, name: str) -> Array:
    return positions[..., kinematics.scene.index(name), :]


def test_the_columns_of_a_tick_have_names_and_units() -> None:
    units = tick_units(Tumbler().mjcf_model())
    root = [f"qpos_root_{index}" for index in range(7)]
    assert list(units) == ["time", *root, "qpos_hip", "qpos_knee", "ctrl_hip", "ctrl_1"]
    assert (units["qpos_hip"], units["qpos_knee"], units["qpos_root_0"], units["ctrl_hip"]) == ("rad", "m", "", "")


def test_points_are_where_mujoco_has_the_geoms() -> None:
    robot, rng = Tumbler(), np.random.default_rng(8)
    kinematics, model = robot.kinematics(), robot.mjcf_model()
    assert {link[:2] for link in kinematics.scene.links} == {(f"{n}_a", f"{n}_b") for n in ("box", "thigh", "rod")}
    data = mujoco.MjData(model)
    rows, expected = [], []
    for _ in range(20):
        data.qpos[:] = rng.normal(size=model.nq)
        mujoco.mj_normalizeQuat(model, data.qpos)
        data.ctrl[:] = rng.normal(size=model.nu)
        mujoco.mj_forward(model, data)
        rows.append((*tick_row(data), 5))
        expected.append([data.body("trunk").xpos.copy(), data.geom("foot").xpos.copy(), data.geom("box").xpos.copy()])
    motion = kinematics.motion(TickTable({**kinematics.units, "step": ""}, np.array(rows)))
    body, foot, box = np.array(expected).transpose(1, 0, 2)
    near = {"rtol": 0, "atol": 1e-12}
    np.testing.assert_allclose(at(kinematics, motion.positions, "body"), body, **near)
    np.testing.assert_allclose(at(kinematics, motion.positions, "foot"), foot, **near)
    ends = [at(kinematics, motion.positions, f"box_{side}") for side in "ab"]
    np.testing.assert_allclose((ends[0] + ends[1]) / 2, box, **near)
    np.testing.assert_allclose(np.linalg.norm(ends[1] - ends[0], axis=1), 0.6, **near)
    rod = [at(kinematics, motion.positions, f"rod_{side}") for side in "ab"]
    np.testing.assert_allclose(rod[0 if np.allclose(rod[0], foot) else 1], foot, **near)
    assert set(motion.step) == {5}
    names = {"position of hip": "rad", "position of knee": "m", "control of hip": "", "control of 1": ""}
    assert kinematics.scene.signals == names
    np.testing.assert_array_equal(motion.signals, np.array(rows)[:, -5:-1])


def test_the_motion_of_a_step_ends_when_the_foot_touches_the_ground() -> None:
    robot, seen = Tumbler(), list[tuple[int, Array]]()
    plant = MjcfPlant(robot, np.random.default_rng(0), lambda rows, step: seen.append((step, np.array(rows))))
    plant.start()
    record = plant.take_step(np.zeros(1))
    assert [step for step, _ in seen] == [0, 1]
    kinematics, rows = robot.kinematics(), np.vstack([rows for _, rows in seen])
    units = {**kinematics.units, "step": ""}
    motion = kinematics.motion(TickTable(units, np.column_stack([rows, np.zeros(len(rows))])))
    assert motion.positions[0] == pytest.approx(kinematics.at_section(robot.space.state_centre))
    assert kinematics.scene.height == "height"
    assert at(kinematics, motion.positions, "body")[-1, 2] == pytest.approx(record.true_next_state[0])
    foot = kinematics.scene.feet.index("foot")
    assert motion.touching[0, foot] == 0
    assert motion.touching[-1, foot] == 1
    assert np.diff(motion.time) == pytest.approx(robot.tick)


def test_a_model_without_visible_geoms_is_drawn_by_all_that_it_has() -> None:
    hidden = XML.replace('<geom name="', '<geom group="3" name="').replace(' group="3" mass="0"', ' mass="0"')
    robot = Tumbler()
    shown = MjcfKinematics(mujoco.MjModel.from_xml_string(hidden), robot.space, robot.place, robot.tick).scene
    assert {"box_a", "shown_elsewhere", "rod_b", "foot"} < {*shown.points}
    assert "shown_elsewhere" not in robot.kinematics().scene.points

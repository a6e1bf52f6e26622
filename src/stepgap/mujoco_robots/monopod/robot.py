"""The monopod as a `Robot`: eight states at the apex, of which three are tracked, by three commands."""

# pyright: reportAttributeAccessIssue=false
# (MuJoCo ships no types for its compiled part.)

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import mujoco
import numpy as np

from stepgap.control.reference import Reference
from stepgap.mujoco_robots.mjcf.mjcf_gap import MjcfGap
from stepgap.mujoco_robots.mjcf.mjcf_robot import ControlLaw, MjcfRobot, MjcfSimulator
from stepgap.mujoco_robots.mjcf.section import Section
from stepgap.mujoco_robots.monopod.hopping import IN_FLIGHT, HoppingGains, body_rotation, hip_angles, hopping, tilt
from stepgap.mujoco_robots.monopod.model import monopod_xml
from stepgap.robots.nominal_maps.affine_map import AffineMap
from stepgap.robots.nominal_maps.simulator import SimulatorMap
from stepgap.step import Array, Quantity, StepMap, StepSpace

MONOPOD_SPACE = StepSpace(
    state=(
        Quantity("speed", "m/s", -0.2, 0.8),
        Quantity("height", "m", 0.64, 0.76),
        Quantity("offset", "m", -0.5, 0.5),
        Quantity("drift", "m/s", -0.5, 0.5, weight=0),
        Quantity("roll", "rad", -0.1, 0.1, weight=0),
        Quantity("pitch", "rad", -0.1, 0.1, weight=0),
        Quantity("roll_rate", "rad/s", -0.4, 0.4, weight=0),
        Quantity("pitch_rate", "rad/s", -0.4, 0.4, weight=0),
    ),
    command=(
        Quantity("foot_x", "m", -0.04, 0.04),
        Quantity("foot_y", "m", -0.04, 0.04),
        Quantity("thrust", "N", -40.0, 40.0),
    ),
)
"""State at the apex: forward speed, height of the hip, place to the left of the line that it follows, velocity to the
left, and tilt of the body with its rates. Command: where the foot lands, and how hard the leg pushes."""

IN_PLACE = np.array([0.0, 0.7, *np.zeros(6)])
"""State of a hop in place, which the middle of the bounds repeats, roughly."""

_DIFFERENCE = 0.1
"""Step of the differences for the derivatives of the model, whose control has ticks [half ranges]."""


def lanes() -> Reference:
    """Straight hopping in one of two lanes; speed, height or lane change every 15 steps."""
    targets = [(0.2, 0.7, 0.0), (0.4, 0.7, 0.0), (0.4, 0.7, 0.25), (0.4, 0.72, 0.25), (0.4, 0.72, 0.0)]
    targets += [(0.6, 0.72, 0.0), (0.6, 0.7, 0.25), (0.3, 0.7, 0.0)]
    segments = [(1 + 15 * number, target) for number, target in enumerate(targets)]
    return Reference.from_segments(("speed", "height", "offset"), segments, steps=15 * len(targets))


@dataclass(frozen=True)
class Monopod(MjcfRobot):
    """A hopper on one leg that moves forward and sideways.

    Attributes:
        gains: Gains of the control law.
    """

    gap: MjcfGap = field(
        default_factory=lambda: replace(
            MjcfGap.none(),
            payload=1.0,
            friction_scale=0.8,
            damping_scale=1.5,
            gear_scale=0.95,
            delay=0.002,
            ground_softness=1.5,
            state_noise=0.005,
            force_noise=0.01,
        )
    )
    gains: HoppingGains = field(default_factory=HoppingGains)

    name = "monopod"
    longest_step = 1.5

    @property
    def space(self) -> StepSpace:
        """Eight states, of which speed, height and offset are tracked; three commands."""
        return MONOPOD_SPACE

    def nominal_maps(self) -> Mapping[str, Callable[[], StepMap]]:
        """The derivatives of the model without differences about a hop in place, and that model itself."""
        return {"linear": self._linear, **super().nominal_maps()}

    def _linear(self) -> AffineMap:
        model, command = SimulatorMap(MONOPOD_SPACE, MjcfSimulator(self), _DIFFERENCE), MONOPOD_SPACE.command_centre
        return AffineMap(MONOPOD_SPACE, IN_PLACE, command, model(IN_PLACE, command), model.jacobian(IN_PLACE, command))

    def references(self) -> Mapping[str, Callable[[], Reference]]:
        """Lanes at several speeds and heights, and stairs."""
        return {"lanes": lanes, **super().references()}

    def mjcf_model(self) -> Any:
        """The model, free in space."""
        return mujoco.MjModel.from_xml_string(monopod_xml())

    def controller(self) -> ControlLaw:
        """The control law, which starts in flight."""
        law, phase = self.gains.law, IN_FLIGHT

        def control(_model: Any, data: Any, command: Array) -> None:
            nonlocal phase
            phase = hopping(law, phase, data.ncon > 0, data.qpos, data.qvel, command, data.ctrl)

        return control

    def section(self) -> Section:
        """The highest point of the hip."""
        return Section(lambda model, data: float(data.qvel[2]), threshold=0.05)

    def state(self, model: Any, data: Any) -> Array:  # noqa: ARG002
        """Velocity, place and tilt of the body."""
        place, velocity = data.qpos, data.qvel
        angles = tilt(body_rotation(place[3:7]))
        return np.array([velocity[0], place[2], place[1], velocity[1], *angles, velocity[3], velocity[4]])

    def place(self, model: Any, data: Any, state: Array) -> None:  # noqa: ARG002
        """At an apex, without any turn about the vertical, with the foot where it lands without a command."""
        speed, height, offset, drift, roll, pitch, *rates = state
        half = 0.5 * roll, 0.5 * pitch
        about_x, about_y = np.array([[np.cos(a), np.sin(a)] for a in half])
        quaternion = [
            about_y[0] * about_x[0],
            about_y[0] * about_x[1],
            about_y[1] * about_x[0],
            -about_y[1] * about_x[1],
        ]
        data.qpos[:7] = [0.0, offset, height, *quaternion]
        data.qpos[7:9] = hip_angles(self.gains.law, body_rotation(data.qpos[3:7]), speed, drift, 0.0, 0.0)
        data.qvel[:5] = [speed, drift, 0.0, *rates]

    def failed(self, model: Any, data: Any) -> bool:  # noqa: ARG002
        """Whether the body is tilted by more than 0.7 rad, or the hip lower than 0.25 m."""
        return bool(data.qpos[2] < 0.25 or np.abs(tilt(body_rotation(data.qpos[3:7]))).max() > 0.7)

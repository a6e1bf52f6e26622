"""Steps as a Gymnasium environment: one action is one step, an episode is one deployment.

Importing this registers `stepgap/Step-v0`, the hopper. `StepEnv` itself knows no robot.
"""

from collections.abc import Callable, Sequence
from difflib import get_close_matches
from functools import partial
from math import isfinite, tau
from typing import Any, Literal

import numpy as np

try:
    import gymnasium
except ModuleNotFoundError as error:
    raise ModuleNotFoundError("stepgap.gym needs Gymnasium: pip install 'stepgap[gym]'", name=error.name) from None
from gymnasium.error import ResetNeeded
from gymnasium.spaces import Box
from numpy.typing import NDArray

from stepgap.control.reference import Reference, paper_reference
from stepgap.experiment.settings import PRESETS
from stepgap.plants.model_plant import ModelPlant
from stepgap.plants.plant import Plant
from stepgap.plants.rig_plant import RigPlant
from stepgap.robots.hopper.apex_map import ApexMap
from stepgap.robots.hopper.hop_control import HopperControl
from stepgap.robots.hopper.parameters import CommandBounds, Gains, RobotParameters
from stepgap.robots.hopper.twin.reality_gap import RealityGap
from stepgap.robots.hopper.twin.twin import Twin
from stepgap.step import Array, StepMap, StepStatus

STEP_ID = "stepgap/Step-v0"
"""What `gymnasium.make` knows the hopper by."""
SEEN = 10.0
"""Observations end this far from the middle of the range of use [half ranges]."""
MISSED = 10.0
"""Squared error at which the reward of a step ends, and which a fall costs for its own and every step that was left
[squared half ranges]: so falling is never better than hopping on."""


class StepEnv(gymnasium.Env[Array, NDArray[Any]]):
    """Tracks a reference on a plant, one step an action.

    - Action: the step command, scaled, −1 and 1 being its bounds (`space.point_of`, `space.command_at`); shape (m,).
      Beyond them it is cut.
    - Observation: state at this apex and the target of the step to come, SI units; shape (2 n,); cut
      at `SEEN`. After a fall the state is that before it; after the last step the target is the last one.
    - Reward: minus the squared distance from the target, in half ranges of the state, at most `MISSED`; a fall costs
      `MISSED` for every step that it takes away.
    - Terminated by a fall, truncated at the reference's end.
    - Info of a step: `command` and `applied` [command units]; `status`, `ok` or why there was no apex; `predicted`, the
      nominal map's next state for what was applied, if it has one; `yaw` at the next apex [rad], if the plant
      measures it; `fault`, what the plant says of its end, if it does.

    Args:
        make_plant: Makes the plant of one episode from the environment's random generator.
        nominal: The map that predicts; it says what state and command are.
        reference: What to track; `reset(options={"reference": …})` takes another one for one episode.

    Raises:
        ValueError: The reference is not one for this map.
    """

    metadata = {"render_modes": []}  # noqa: RUF012  (as Gymnasium has it)

    def __init__(self, make_plant: Callable[[np.random.Generator], Plant], nominal: StepMap, reference: Reference):
        reference.check(nominal.space)
        self.nominal, self.reference, self.space = nominal, reference, nominal.space
        self._make_plant, self._tracked = make_plant, reference
        self._plant: Plant | None = None
        self._state, self._done = np.full(len(self.space.state), np.nan), 0
        centre, reach = np.tile(self.space.state_centre, 2), SEEN * np.tile(self.space.state_scale, 2)
        self.observation_space = Box(centre - reach, centre + reach, dtype=np.float64)
        self.action_space = Box(-1.0, 1.0, (len(self.space.command),), dtype=np.float32)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Array, dict[str, Any]]:
        """Starts an episode; the same seed gives the same one.

        Raises:
            ValueError: An option other than `reference`, or a reference that is not one for this map.
        """
        super().reset(seed=seed)
        self.close()
        self._tracked = _reference_of(options or {}, self.reference)
        self._tracked.check(self.space)
        self._plant, self._done = self._make_plant(self.np_random), 0
        self._state = self._plant.start()
        return self._observation(), {}

    def step(self, action: NDArray[Any]) -> tuple[Array, float, bool, bool, dict[str, Any]]:
        """Executes one step.

        Raises:
            ResetNeeded: There is no episode, or it is over.
            ValueError: The action has the wrong shape.
        """
        if self._plant is None:
            raise ResetNeeded("the episode is over, or none was begun: call reset()")
        point = np.asarray(action, float)
        if point.shape != self.action_space.shape:
            raise ValueError(f"the action has shape {point.shape}; it must be {self.action_space.shape}")
        record = self._plant.take_step(self.space.command_at(point))
        target, left = self._tracked.targets[self._done], len(self._tracked) - self._done
        predicted, status = self.nominal.evaluate(record.state, record.applied)
        info = {"command": record.command, "applied": record.applied, "status": record.status.label}
        info |= {"predicted": predicted} if status == StepStatus.OK else {}
        info |= {"yaw": record.yaw_after} if isfinite(record.yaw_after) else {}
        info |= {"fault": self._plant.fault} if self._plant.fault else {}
        fell = record.status != StepStatus.OK
        if fell:
            reward = -MISSED * left
        else:
            reward = -min(float(np.sum(((record.next_state - target) / self.space.state_scale) ** 2)), MISSED)
            self._state, self._done = record.next_state, self._done + 1
        truncated = not fell and left == 1
        if fell or truncated:
            self.close()
        return self._observation(), reward, fell, truncated, info

    def close(self) -> None:
        """Stops the plant."""
        if self._plant is not None:
            self._plant.stop()
            self._plant = None

    def _observation(self) -> Array:
        """State and next target; shape (2 n,)."""
        target = self._tracked.targets[min(self._done, len(self._tracked) - 1)]
        box = self.observation_space
        assert isinstance(box, Box)
        return np.clip(np.concatenate([self._state, target]), box.low, box.high)


def hopper_env(
    plant: Literal["twin", "model"] = "twin",
    gap: str | RealityGap = "paper",
    noise: Sequence[float] = (0.005, 0.002),
    reference: Reference | None = None,
    robot: RobotParameters = RobotParameters(),  # noqa: B008  (frozen)
    gains: Gains = Gains(),  # noqa: B008  (frozen)
    bounds: CommandBounds = CommandBounds(),  # noqa: B008  (frozen)
) -> StepEnv:
    """The hopper as an environment; what `gymnasium.make("stepgap/Step-v0", …)` calls.

    Args:
        plant: `twin` is the MuJoCo twin behind the 1 kHz loop, on a floor of its own in every episode; `model` is the
            physics model with noise, some hundred times as fast.
        gap: How the twin differs from the model: a `RealityGap`, or a preset, `paper` or `none`.
        noise: Standard deviation of what is added to every next state of `model`; shape (2,) [m/s, m].
        reference: What to track; the paper's if none.
        robot: The robot as the physics model takes it.
        gains: Its joint controller.
        bounds: Range of the command.

    Raises:
        ValueError: An argument is not what it must be.
    """
    nominal, reference = ApexMap(robot, gains, bounds), reference or paper_reference()
    if plant == "model":
        std = np.asarray(noise, float)
        if std.shape != (2,) or not (np.isfinite(std) & (std >= 0)).all():
            raise ValueError(f"noise = {noise}, but it must be two numbers that are not negative [m/s, m]")
        return StepEnv(partial(ModelPlant, nominal, reference.targets[0], std), nominal, reference)
    if plant != "twin":
        raise ValueError(f"plant = {plant!r}, but it must be {_one_of(plant, ('twin', 'model'))}")
    if isinstance(gap, str):
        if gap not in PRESETS:
            raise ValueError(f"gap = {gap!r}, but it must be a RealityGap, or {_one_of(gap, tuple(PRESETS))}")
        gap = PRESETS[gap]()

    def make_plant(rng: np.random.Generator) -> Plant:
        return RigPlant(Twin(robot, gap, rng, floor_yaw=rng.uniform(0, tau)), HopperControl(robot, gains, bounds))

    make_plant(np.random.default_rng(0))  # whatever is wrong with the twin is said now
    return StepEnv(make_plant, nominal, reference)


def _reference_of(options: dict[str, Any], usual: Reference) -> Reference:
    """The reference among the options of a reset, or the usual one."""
    unknown = options.keys() - {"reference"}
    if unknown:
        raise ValueError(f"unknown option {', '.join(sorted(unknown))} of reset; 'reference' is the only one")
    reference = options.get("reference", usual)
    if not isinstance(reference, Reference):
        raise ValueError(f"option 'reference' must be a stepgap Reference, not {type(reference).__name__}")
    return reference


def _one_of(given: object, known: tuple[str, ...]) -> str:
    close = get_close_matches(str(given), known, n=1)
    return " or ".join(map(repr, known)) + (f"; did you mean {close[0]!r}?" if close else "")


gymnasium.register(STEP_ID, entry_point="stepgap.gym:hopper_env")

"""Steps as a Gymnasium environment: one action is one step, an episode is one deployment.

Importing this module registers `stepgap/Step-v0`, which takes any robot by its name.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from math import isfinite
from typing import Any

import numpy as np

try:
    import gymnasium
except ModuleNotFoundError as error:
    raise ModuleNotFoundError("stepgap.gym needs Gymnasium: pip install 'stepgap[gym]'", name=error.name) from None
from gymnasium.error import ResetNeeded
from gymnasium.spaces import Box
from numpy.typing import NDArray

from stepgap.base.plugins import one_of
from stepgap.control.reach import whole_states
from stepgap.control.reference import Reference
from stepgap.control.settings import ControlSettings
from stepgap.control.wrapped_map import CommandChange
from stepgap.experiment.inputs import load_reference
from stepgap.experiment.nominal import load_nominal
from stepgap.experiment.settings import Experiment
from stepgap.plants.model_plant import ModelPlant
from stepgap.plants.plant import Plant
from stepgap.robots.entry_points import load_robot, simulations_of
from stepgap.robots.robot import Robot
from stepgap.step import Array, StepMap, StepStatus

STEP_ID = "stepgap/Step-v0"  # Name of the environment for `gymnasium.make`, by default that of the hopper
MODEL = "model"  # Plant that is the nominal map with noise
OBSERVATION_LIMIT = 10.0
"""Distance from the middle of the range at which observations are clipped [half ranges]."""
LARGEST_COST = 10.0
"""Squared error at which the cost of a step is clipped [squared half ranges]. A failed step costs as much for itself
and each remaining step, so that failing is never better than continuing."""


class StepEnv(gymnasium.Env[Array, NDArray[Any]]):
    """Tracks a reference on a plant, one step per action.

    - Action: the step command, scaled so that its bounds are −1 and 1 (`space.point_of`, `space.command_at`); shape
      (m,). Larger values are clipped, as are changes of a command that are larger than `largest_change`.
    - Observation: state before the step and target of the next step, SI units; shape (2 n,); clipped at
      `OBSERVATION_LIMIT`. After a failed step the state is the one before it; after the last step the target is the
      last one.
    - Reward: minus the squared distance from the target, in half ranges of the state, at most `LARGEST_COST`; a
      failed step costs `LARGEST_COST` for its own and each remaining step.
    - Terminated by a failed step, truncated at the reference's end.
    - Info of a step: `command` and `applied` [command units]; `status`, `ok` or the reason why there is no next state;
      `predicted`, the nominal map's next state for the requested command, if there is one; the quantities
      of `space.context` that the plant has measured, by name; `fault`, the plant's message about a fault, if any.

    Args:
        make_plant: Makes the plant of one episode from the environment's random generator.
        nominal: Map used for predictions; it defines state and command.
        reference: Reference to track; `reset(options={"reference": …})` sets another one for one episode.
        largest_change: As in `ControlSettings`.

    Raises:
        ValueError: The reference does not fit this map, or the largest change is not possible.
    """

    metadata = {"render_modes": []}  # noqa: RUF012  (as Gymnasium has it)

    def __init__(
        self,
        make_plant: Callable[[np.random.Generator], Plant],
        nominal: StepMap,
        reference: Reference,
        largest_change: float = 1.0,
    ):
        reference = reference.of(nominal.space)
        self._any_change = CommandChange(ControlSettings(largest_change=largest_change).largest_change)
        self.nominal = nominal
        self.reference = reference
        self.space = nominal.space
        self._make_plant = make_plant
        self._tracked = reference
        self._plant: Plant | None = None
        self._state = np.full(len(self.space.state), np.nan)
        self._done = 0
        centre = np.tile(self.space.state_centre, 2)
        limit = OBSERVATION_LIMIT * np.tile(self.space.state_scale, 2)
        self.observation_space = Box(centre - limit, centre + limit, dtype=np.float64)
        self.action_space = Box(-1.0, 1.0, (len(self.space.command),), dtype=np.float32)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Array, dict[str, Any]]:
        """Starts an episode; the same seed gives the same episode.

        Raises:
            ValueError: There is an option other than `reference`, or the reference does not fit this map.
        """
        super().reset(seed=seed)
        self.close()
        self._tracked = _reference_of(options or {}, self.reference).of(self.space)
        self._plant = self._make_plant(self.np_random)
        self._done = 0
        self._change = self._any_change
        self._state = self._plant.start()
        return self._observation(), {}

    def step(self, action: NDArray[Any]) -> tuple[Array, float, bool, bool, dict[str, Any]]:
        """Executes one step.

        Raises:
            ResetNeeded: No episode was started, or it has ended.
            ValueError: The action has the wrong shape.
        """
        if self._plant is None:
            raise ResetNeeded("the episode has ended, or none was started: call reset()")
        point = np.asarray(action, float)
        if point.shape != self.action_space.shape:
            raise ValueError(f"the action has shape {point.shape}; it must be {self.action_space.shape}")
        bounds = self._change.bounds(self.space)
        command = np.clip(self.space.command_at(point), bounds.command_lower, bounds.command_upper)
        self._change = self._change.after(command)
        record = self._plant.take_step(command)
        target = self._tracked.targets[self._done]
        remaining = len(self._tracked) - self._done
        predicted, status = self.nominal.evaluate(record.state, record.requested)
        info = {"command": record.command, "applied": record.applied, "status": record.status.label}
        info |= {"predicted": predicted} if status == StepStatus.OK else {}
        info |= {name: value for name, value in record.context.items() if isfinite(value)}
        info |= {"fault": self._plant.fault} if self._plant.fault else {}
        failed = record.status != StepStatus.OK
        if failed:
            reward = -LARGEST_COST * remaining
        else:
            squared = float(np.nansum(((record.next_state - target) / self.space.error_scale) ** 2))
            reward = -min(squared, LARGEST_COST)
            self._state = record.next_state
            self._done = self._done + 1
        truncated = not failed and remaining == 1
        if failed or truncated:
            self.close()
        return self._observation(), reward, failed, truncated, info

    def close(self) -> None:
        """Stops the plant."""
        if self._plant is not None:
            self._plant.stop()
            self._plant = None

    def _observation(self) -> Array:
        """State and next target, the middle of the range of use where there is none; shape (2 n,)."""
        target = self._tracked.targets[min(self._done, len(self._tracked) - 1)]
        target = np.where(np.isnan(target), self.space.state_centre, target)
        box = self.observation_space
        assert isinstance(box, Box)
        return np.clip(np.concatenate([self._state, target]), box.low, box.high)


def robot_env(
    robot: str | Robot = "hopper",
    plant: str = "",
    noise: Sequence[float] | None = None,
    reference: Reference | None = None,
    render_mode: str | None = None,
    weights: Mapping[str, float] | None = None,
    largest_change: float = 1.0,
) -> StepEnv:
    """Makes the environment of a robot; `gymnasium.make("stepgap/Step-v0", …)` calls it.

    Args:
        robot: Name of a robot, or a robot with its settings, such as `Hopper(gap=RealityGap.none())`.
        plant: Name of a simulated plant of the robot, in another world in every episode; empty for its first one. Or
            `model`, its nominal map with noise, which is much faster.
        noise: Standard deviation of the noise added to every next state of `model`; shape (n,) [state units]. None
            for a hundredth of the ranges of use.
        reference: Reference to track; None for the robot's first one.
        render_mode: None; there are no pictures.
        weights: As in `Experiment`; they decide the reward.
        largest_change: As in `ControlSettings`.

    Raises:
        ValueError: An argument is wrong.
    """
    if render_mode is not None:
        raise ValueError(
            f"render_mode = {render_mode!r}, but this environment draws no pictures; leave it out, and see the robot "
            "by `stepgap run --view` or in the report of a run"
        )
    chosen = load_robot(robot) if isinstance(robot, str) else robot
    settings = Experiment(chosen, plant="" if plant == MODEL else plant, weights=weights or {})
    nominal = load_nominal(settings).map
    reference = reference or load_reference(settings, settings.space)
    if plant == MODEL:
        std = 0.02 * chosen.space.state_scale if noise is None else np.asarray(noise, float)
        if std.shape != chosen.space.state_scale.shape or not (np.isfinite(std) & (std >= 0)).all():
            names = ", ".join(f"{quantity.name} [{quantity.unit}]" for quantity in chosen.space.state)
            raise ValueError(f"noise = {noise}, but it must be numbers that are not negative, for {names}")
        (start,) = whole_states(nominal, reference.of(nominal.space).targets[:1])
        make_model = partial(ModelPlant, nominal, start, std)
        return StepEnv(make_model, nominal, reference, largest_change)
    simulations = simulations_of(chosen)
    if settings.plant not in simulations:
        plants = (*simulations, MODEL)
        raise ValueError(f"plant = {settings.plant!r}, but it must be {one_of(settings.plant, plants)}")
    make = simulations[settings.plant]

    def make_plant(rng: np.random.Generator) -> Plant:
        return make(rng).plant(rng)

    make_plant(np.random.default_rng(0))  # reports errors of the simulation now
    return StepEnv(make_plant, nominal, reference, largest_change)


def _reference_of(options: dict[str, Any], default: Reference) -> Reference:
    """The reference among the options of a reset, or the default one."""
    unknown = options.keys() - {"reference"}
    if unknown:
        raise ValueError(f"unknown option {', '.join(sorted(unknown))} of reset; the only option is 'reference'")
    reference = options.get("reference", default)
    if not isinstance(reference, Reference):
        raise ValueError(f"option 'reference' must be a stepgap Reference, not {type(reference).__name__}")
    return reference


gymnasium.register(STEP_ID, entry_point="stepgap.gym:robot_env")

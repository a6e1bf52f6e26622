"""StepGap closes the sim-to-real gap of a legged robot one step at a time.

The flow, from the model to a robot that tracks:

1. `ApexMap` predicts the next apex from this one and a step command (Eq. 10).
2. `StepController` finds the command whose prediction is the target (Eq. 11).
3. A `Plant` executes it: `RigPlant` runs the 1 kHz loop on a `Rig`, `Twin` stands in for the robot.
4. Every step becomes a `StepRecord`; `fit_residual` learns actual − nominal from them (Eq. 12).
5. `CorrectedMap` is nominal + residual (Eq. 13), again a `StepMap`, so 2 to 4 repeat with it.

`run` makes the whole experiment in a folder, as the command `stepgap run` does; `run_experiment` is its loop. The other
verbs of the command line are functions of `stepgap.verbs`.
"""

import re
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from stepgap.base.errors import InputError as InputError
    from stepgap.base.errors import StepGapError as StepGapError
    from stepgap.base.json_data import number as number
    from stepgap.base.ranges import require as require
    from stepgap.cli.python_door import run as run
    from stepgap.control.cautious_controller import CautiousController as CautiousController
    from stepgap.control.command_table import CommandTable as CommandTable
    from stepgap.control.command_table import build_table as build_table
    from stepgap.control.limit_cycle import FixedPoint as FixedPoint
    from stepgap.control.limit_cycle import ReachableSet as ReachableSet
    from stepgap.control.limit_cycle import fixed_point as fixed_point
    from stepgap.control.limit_cycle import reachable_set as reachable_set
    from stepgap.control.reference import Reference as Reference
    from stepgap.control.settings import ControlSettings as ControlSettings
    from stepgap.control.step_controller import StepController as StepController
    from stepgap.control.step_controller import StepPlan as StepPlan
    from stepgap.experiment.deployment import DeploymentController as DeploymentController
    from stepgap.experiment.loop import Observer as Observer
    from stepgap.experiment.loop import Plants as Plants
    from stepgap.experiment.loop import Setup as Setup
    from stepgap.experiment.loop import run_experiment as run_experiment
    from stepgap.experiment.run import Run as Run
    from stepgap.experiment.run import load_run as load_run
    from stepgap.learning.corrected_map import CorrectedMap as CorrectedMap
    from stepgap.learning.learner import Learner as Learner
    from stepgap.learning.observations import Observations as Observations
    from stepgap.learning.regression import BatchRegression as BatchRegression
    from stepgap.learning.regression import Regression as Regression
    from stepgap.learning.regression import ResidualModel as ResidualModel
    from stepgap.learning.regression import TrainingData as TrainingData
    from stepgap.learning.residual import Residual as Residual
    from stepgap.learning.residual_fit import fit_residual as fit_residual
    from stepgap.learning.settings import LearningSettings as LearningSettings
    from stepgap.learning.steps import LoggedStep as LoggedStep
    from stepgap.learning.steps import Steps as Steps
    from stepgap.mujoco_robots.mjcf.mjcf_gap import MjcfGap as MjcfGap
    from stepgap.mujoco_robots.mjcf.mjcf_robot import MjcfRobot as MjcfRobot
    from stepgap.mujoco_robots.mjcf.section import Section as Section
    from stepgap.mujoco_robots.mjcf.section import apex as apex
    from stepgap.mujoco_robots.mjcf.section import next_foot as next_foot
    from stepgap.mujoco_robots.mjcf.section import touchdown as touchdown
    from stepgap.plants.model_plant import ModelPlant as ModelPlant
    from stepgap.plants.plant import Plant as Plant
    from stepgap.plants.rig_plant import RigPlant as RigPlant
    from stepgap.records.summary import Deployment as Deployment
    from stepgap.rigs.rig import Rig as Rig
    from stepgap.rigs.rig import RigFault as RigFault
    from stepgap.rigs.rig import SensorModel as SensorModel
    from stepgap.robots.hopper.model.apex_map import ApexMap as ApexMap
    from stepgap.robots.hopper.paper import paper_reference as paper_reference
    from stepgap.robots.hopper.parameters import CommandBounds as CommandBounds
    from stepgap.robots.hopper.parameters import Gains as Gains
    from stepgap.robots.hopper.parameters import RobotParameters as RobotParameters
    from stepgap.robots.hopper.robot import Hopper as Hopper
    from stepgap.robots.hopper.tick.hop_control import HopperControl as HopperControl
    from stepgap.robots.hopper.tick.sensors import HopperReading as HopperReading
    from stepgap.robots.hopper.tick.sensors import HopperSensorModel as HopperSensorModel
    from stepgap.robots.hopper.twin.reality_gap import RealityGap as RealityGap
    from stepgap.robots.hopper.twin.twin import Twin as Twin
    from stepgap.robots.map_simulation import MapSimulation as MapSimulation
    from stepgap.robots.nominal_maps.simulator import Simulator as Simulator
    from stepgap.robots.nominal_maps.simulator import SimulatorMap as SimulatorMap
    from stepgap.robots.published_result import PublishedResult as PublishedResult
    from stepgap.robots.robot import Robot as Robot
    from stepgap.robots.robot import Simulation as Simulation
    from stepgap.robots.scene import Kinematics as Kinematics
    from stepgap.robots.scene import Link as Link
    from stepgap.robots.scene import Motion as Motion
    from stepgap.robots.scene import Scene as Scene
    from stepgap.step import ContextQuantity as ContextQuantity
    from stepgap.step import Outcome as Outcome
    from stepgap.step import Quantity as Quantity
    from stepgap.step import StepFailed as StepFailed
    from stepgap.step import StepMap as StepMap
    from stepgap.step import StepRecord as StepRecord
    from stepgap.step import StepSpace as StepSpace
    from stepgap.step import StepStatus as StepStatus
    from stepgap.step import difference_jacobian as difference_jacobian

_LISTED = re.compile(r"^    from stepgap\.(\S+) import (\w+)", re.MULTILINE)
_MODULES = {name: module for module, name in _LISTED.findall(Path(__file__).read_text("utf-8"))}
"""The module of each name in the list above, which type checkers read, too.

It is imported when the name is first used, so that the command line starts quickly.
"""

_RENAMED = {"LoadedRun": "Run", "StepLog": "Steps"}
"""Public names of earlier versions, with those that replace them."""

_FIRST = (
    *("run", "load_run", "Run", "Deployment", "Steps", "Reference", "paper_reference", "verbs"),
    *("Robot", "Hopper", "MjcfRobot", "Simulation", "Plant", "RigPlant", "ModelPlant", "Rig", "Twin", "RealityGap"),
    *("StepMap", "StepSpace", "Quantity", "StepRecord", "StepStatus", "ApexMap", "CorrectedMap", "Residual"),
    *("StepController", "ControlSettings", "LearningSettings", "ResidualModel", "fit_residual", "fixed_point"),
    *("reachable_set", "run_experiment", "Setup", "InputError", "StepGapError", "StepFailed"),
)
"""Names that `dir` shows, with which people begin; the others are parts of these."""

__all__ = sorted(_MODULES)  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    """A public name; its module is imported when it is first used. `__version__` is the installed version."""
    if name == "__version__":
        from importlib.metadata import version  # its import takes a tenth of that of the command line

        return version("stepgap")
    if name == "verbs":
        return import_module("stepgap.verbs")
    if name in _RENAMED:
        raise AttributeError(f"stepgap has no {name!r} any more; use stepgap.{_RENAMED[name]}")
    if name not in _MODULES:
        raise AttributeError(f"stepgap has no {name!r}; its public names are {', '.join(__all__)}")
    value = globals()[name] = getattr(import_module(f"stepgap.{_MODULES[name]}"), name)
    return value


def __dir__() -> list[str]:
    """The names with which people begin; `__all__` has all public ones."""
    return [*_FIRST, *(name for name in globals() if name.startswith("__"))]

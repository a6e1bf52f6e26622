"""A trial of the learning benchmark: one random twin and one seed, on which every method makes its deployments.

Twin T draws its gap from `random_stream(T)` and its floor from `random_stream(T, 0)`; deployment K draws from
`random_stream(T, seed, K)` for every method, so methods are compared under equal noise.
"""

from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from itertools import islice
from math import tau

from benchmarks.learning.tasks import Change, Task
from stepgap.base.random_streams import random_stream
from stepgap.control.settings import ALL_RULES, ControlSettings
from stepgap.experiment.deployment import AdaptiveMap, ExecutedSteps, deploy
from stepgap.learning.learner import Learner
from stepgap.learning.prior import Prior
from stepgap.learning.settings import LearningSettings
from stepgap.learning.steps import Steps
from stepgap.plants.plant import Plant
from stepgap.plants.rig_plant import RigPlant
from stepgap.plants.ticks.stream import OnTicks
from stepgap.rigs.rig import RigFault
from stepgap.robots.hopper.model.apex_map import ApexMap
from stepgap.robots.hopper.tick.hop_control import HopperControl
from stepgap.robots.hopper.twin.model import GroundProfile
from stepgap.robots.hopper.twin.reality_gap import RealityGap
from stepgap.robots.hopper.twin.twin import Twin
from stepgap.step import StepMap

FIRST_STEPS = 20
"""Number of steps that the uncorrected robot must complete; otherwise the twin is drawn again."""

FIRST = "deployment 0"
"""Key of deployment 0 among the deployments that methods have in common."""

UNCORRECTED_LEARNING = LearningSettings(residual="none")
"""Settings of a learner that does not learn."""


@dataclass(frozen=True, eq=False)
class Trial:
    """A twin and a seed.

    Attributes:
        nominal: Map of the physics model.
        gap: Differences of the twin from the model.
        task: What the robot is to do.
        twin: Number of the twin.
        seed: Seed of the noise.
        learning: Settings of learning that are changed for every learner, by their names.
        priors: Priors over robots with which a learner of the exact nominal map begins, as in a run.
        control: Settings of step control; deployment 0 without correction always has all rules.
        made: Deployments that several methods have in common, by what distinguishes them.
    """

    nominal: ApexMap
    gap: RealityGap
    task: Task
    twin: int
    seed: int
    learning: Mapping[str, bool] = field(default_factory=dict)
    priors: Sequence[Prior] = ()
    control: ControlSettings = ALL_RULES
    made: dict[str, Steps] = field(default_factory=dict)

    def once(self, key: str, make: Callable[[], Steps]) -> Steps:
        """Makes a deployment that several methods have in common, unless it was made before."""
        if key not in self.made:
            self.made[key] = make()
        return self.made[key]

    @property
    def first(self) -> Steps:
        """Steps of deployment 0 without correction, from which most methods learn."""
        all_rules = replace(self, control=ALL_RULES)
        return self.once(FIRST, lambda: all_rules.deploy(self.uncorrected(self.nominal), 0))

    def learner(self, nominal: StepMap, log: Steps, settings: LearningSettings, iteration: int) -> Learner:
        """Learner before a deployment, with the changes of its settings that the trial makes."""
        priors = self.priors if nominal is self.nominal else ()
        return Learner.start(nominal, log, replace(settings, **self.learning), iteration, priors)

    def uncorrected(self, nominal: StepMap) -> Learner:
        """Learner without any knowledge but a map."""
        return self.learner(nominal, Steps(nominal.space), UNCORRECTED_LEARNING, 0)

    def twin_of(self, iteration: int) -> Twin:
        """Twin of a deployment."""
        robot, rng = self.nominal.robot, random_stream(self.twin, self.seed, iteration)
        ground = GroundProfile(self.gap, robot.boom_length, random_stream(self.twin, 0))
        return Twin(robot, self.gap, rng, ground=ground, floor_yaw=rng.uniform(0, tau))

    def deploy(
        self,
        learner: AdaptiveMap,
        iteration: int,
        most_steps: int | None = None,
        on_ticks: OnTicks | None = None,
    ) -> Steps:
        """Steps of a deployment that a method learns from; none if the hop before the first step failed."""
        steps_on = self._tracking(learner, iteration, 0)
        return self._record(steps_on, iteration, None, most_steps, on_ticks)

    def measure(self, learner: AdaptiveMap, iteration: int, exploration: int = 0) -> Steps:
        """Steps of the deployment by which a method is judged; in the midst of it the task may change the robot."""
        return self.measure_steps(self._tracking(learner, iteration, exploration), iteration)

    def measure_steps(self, steps_on: Callable[[Plant], ExecutedSteps], iteration: int) -> Steps:
        """As `measure`, for a method that does not plan its steps with a `StepMap`, but makes them on a plant."""
        return self._record(steps_on, iteration, self.task.change, None, None)

    def _tracking(self, learner: AdaptiveMap, iteration: int, exploration: int) -> Callable[[Plant], ExecutedSteps]:
        return lambda plant: deploy(learner, plant, self.task.reference, iteration, exploration, self.control)

    def _record(
        self,
        steps_on: Callable[[Plant], ExecutedSteps],
        iteration: int,
        change: Change | None,
        most_steps: int | None,
        on_ticks: OnTicks | None,
    ) -> Steps:
        nominal, log, twin = self.nominal, Steps(self.nominal.space), self.twin_of(iteration)
        plant = RigPlant(twin, HopperControl(nominal.robot, nominal.gains, nominal.bounds), on_ticks)
        with closing(steps_on(plant)) as steps:
            try:
                for logged in islice(steps, most_steps):
                    log += [logged]
                    if change and logged.step == change.step - 1:
                        twin.become(change.of(self.gap))
            except RigFault:
                if len(log):
                    raise
        return log


Method = Callable[[Trial], Sequence[Steps]]
"""Makes the deployments that a learning method needs, from number 0 on, the last of which is measured."""


def hopping_gap(nominal: ApexMap, task: Task, twin: int) -> tuple[RealityGap, int]:
    """Draws the gap of a twin, again if one of the first steps fails; returns gap and number of redraws."""
    rng, drawn_again = random_stream(twin), 0
    while True:
        trial = Trial(nominal, task.gap_of(RealityGap.random(rng)), task, twin, seed=0)
        log = trial.deploy(trial.uncorrected(nominal), 0, most_steps=FIRST_STEPS)
        if len(log) and not log.failed_steps:
            return trial.gap, drawn_again
        drawn_again += 1

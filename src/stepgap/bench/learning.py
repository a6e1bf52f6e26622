"""`stepgap bench learning`: comparison of learning methods on a family of random twins.

For each twin and seed there is one deployment without correction, from which all methods learn, and then a
redeployment by each method. Twin T draws its gap from `random_stream(T)` and its floor from `random_stream(T, 0)`;
deployment K draws from `random_stream(T, seed, K)` for every method, so methods are compared under equal noise.
"""

import json
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from functools import partial
from itertools import islice
from math import tau

import mujoco.sysid
import numpy as np
from threadpoolctl import threadpool_limits

from stepgap.base.normal import INTERVAL_95
from stepgap.base.random_streams import random_stream
from stepgap.bench.baselines import IntegralCorrection, identify
from stepgap.control.reference import Reference
from stepgap.experiment.bands import hops_to_band
from stepgap.experiment.deployment import AdaptiveMap, deploy
from stepgap.experiment.outcome import summarise
from stepgap.learning.entry_points import residual_models, residual_names
from stepgap.learning.learner import Learner
from stepgap.learning.settings import AUTO, LearningSettings
from stepgap.learning.step_log import StepLog
from stepgap.plants.compiled_rig import Rows
from stepgap.plants.rig_plant import RigPlant
from stepgap.report.learning import UNCORRECTED, DeploymentRow
from stepgap.rigs.rig import RigFault
from stepgap.robots.hopper.apex_map import ApexMap
from stepgap.robots.hopper.hop_control import HopperControl
from stepgap.robots.hopper.tick import Tick
from stepgap.robots.hopper.twin.family import random_gap
from stepgap.robots.hopper.twin.model import GroundProfile
from stepgap.robots.hopper.twin.reality_gap import RealityGap
from stepgap.robots.hopper.twin.twin import Twin
from stepgap.step import Array

FIRST_STEPS = 20
"""Number of steps that the uncorrected robot must make without a fall; otherwise the twin is drawn again."""

EXPLORATION = 20
"""Number of exploratory hops of the methods that explore."""


@dataclass(frozen=True, eq=False)
class Trial:
    """A twin and a seed.

    Attributes:
        nominal: Map of the physics model.
        gap: Differences of the twin from the model.
        reference: Reference to track.
        twin: Number of the twin.
        seed: Seed of the noise.
        redeployed: Steps of the first redeployment, by the residual used as JSON.
    """

    nominal: ApexMap
    gap: RealityGap
    reference: Reference
    twin: int
    seed: int
    redeployed: dict[str, StepLog] = field(default_factory=dict)

    def uncorrected(self) -> Learner:
        """Learner without any knowledge."""
        return Learner.start(self.nominal, StepLog(self.nominal.space), LearningSettings(residual="none"), 0)

    def twin_of(self, iteration: int) -> Twin:
        """Twin of a deployment."""
        robot, rng = self.nominal.robot, random_stream(self.twin, self.seed, iteration)
        ground = GroundProfile(self.gap, robot.boom_length, random_stream(self.twin, 0))
        return Twin(robot, self.gap, rng, ground=ground, floor_yaw=rng.uniform(0, tau))

    def deploy(
        self,
        learner: AdaptiveMap,
        iteration: int,
        exploration: int = 0,
        most_steps: int | None = None,
        on_ticks: Callable[[Rows], None] | None = None,
    ) -> StepLog:
        """Steps of a deployment; none if the hop before the first step failed."""
        nominal, log = self.nominal, StepLog(self.nominal.space)
        plant = RigPlant(self.twin_of(iteration), HopperControl(nominal.robot, nominal.gains, nominal.bounds), on_ticks)
        with closing(deploy(learner, plant, self.reference, iteration, exploration)) as steps:
            try:
                for logged in islice(steps, most_steps):
                    log += [logged]
            except RigFault:
                if len(log):
                    raise
        return log


Method = Callable[[Trial, StepLog], StepLog]
"""Function of a trial and the steps of its deployment 0 that returns the steps of the method's deployment."""


def _integral(trial: Trial, log: StepLog) -> StepLog:
    return trial.deploy(IntegralCorrection.start(trial.nominal, log), 1)


def _identified(trial: Trial, log: StepLog) -> StepLog:
    return trial.deploy(Learner.start(identify(trial.nominal, log), log, LearningSettings(residual="none"), 1), 1)


def _sysid(trial: Trial, log: StepLog) -> StepLog:
    from stepgap.bench.identification import identify_from_ticks

    rows: list[Sequence[float]] = []
    again = trial.deploy(trial.uncorrected(), 0, on_ticks=rows.extend)  # exactly the same deployment
    if not len(again):
        return trial.deploy(trial.uncorrected(), 1)
    found = identify_from_ticks(trial.nominal, list(map(Tick.of, rows)), trial.twin_of(0).sensor_model)
    return trial.deploy(Learner.start(found, log, LearningSettings(residual="none"), 1), 1)


def _residual(trial: Trial, log: StepLog, kind: str) -> StepLog:
    learner = Learner.start(trial.nominal, log, LearningSettings(residual=kind), 1)
    key = json.dumps(learner.residual.to_dict())
    if key not in trial.redeployed:  # `auto` chooses one of the others, with the same deployment
        trial.redeployed[key] = trial.deploy(learner, 1)
    return trial.redeployed[key]


def _from_the_first_hop(trial: Trial, log: StepLog, learning: LearningSettings) -> StepLog:
    return trial.deploy(Learner.start(trial.nominal, StepLog(log.space), learning, 0), 0, learning.exploration)


SKIPPED = {} if hasattr(mujoco.sysid, "optimize") else {"sysid": "needs the packages of stepgap[sysid]"}
"""Methods that cannot be used, with the reason."""

WITHOUT_RESIDUAL: dict[str, Method] = {
    "integral": _integral,
    "identified": _identified,
    **({} if "sysid" in SKIPPED else {"sysid": _sysid}),
}
"""Methods that learn from deployment 0 without a residual."""

FROM_THE_FIRST_HOP: dict[str, Method] = {
    "online": partial(_from_the_first_hop, learning=LearningSettings(online=True)),
    "exploring": partial(_from_the_first_hop, learning=LearningSettings(exploration=EXPLORATION)),
    "exploring_online": partial(_from_the_first_hop, learning=LearningSettings(online=True, exploration=EXPLORATION)),
}
"""Methods that learn during deployment 0, all with the default residual."""


def methods() -> dict[str, Method]:
    """All methods by name, including every installed residual except `none`, which is deployment 0."""
    kinds = (*(name for name in residual_names() if name != UNCORRECTED), AUTO)
    return WITHOUT_RESIDUAL | {kind: partial(_residual, kind=kind) for kind in kinds} | FROM_THE_FIRST_HOP


def default_methods() -> list[str]:
    """Names of the methods that are compared by default; their residuals are the candidates of `auto`."""
    kinds = [model.name for model in residual_models() if model.candidate and model.name != UNCORRECTED]
    return [*WITHOUT_RESIDUAL, *kinds, AUTO, *FROM_THE_FIRST_HOP]


def measure_twin(reference: Reference, twin: int, seed: int, names: Sequence[str]) -> list[DeploymentRow]:
    """Measures of all methods on a twin; the first row is that of the common deployment 0."""
    nominal = ApexMap()
    with threadpool_limits(limits=1, user_api="blas"):
        gap, drawn_again = hopping_gap(nominal, reference, twin)
        trial = Trial(nominal, gap, reference, twin, seed)
        log = trial.deploy(trial.uncorrected(), 0)
        rows = [_row(trial, UNCORRECTED, [log]) | {"drawn_again": drawn_again}]
        for name in names:
            before = [] if name in FROM_THE_FIRST_HOP else [log]
            rows.append(_row(trial, name, [*before, methods()[name](trial, log)]))
    return rows


def hopping_gap(nominal: ApexMap, reference: Reference, twin: int) -> tuple[RealityGap, int]:
    """Draws the gap of a twin, again if the robot falls within the first steps; returns gap and number of redraws."""
    rng, drawn_again = random_stream(twin), 0
    while True:
        trial = Trial(nominal, random_gap(rng), reference, twin, seed=0)
        log = trial.deploy(trial.uncorrected(), 0, most_steps=FIRST_STEPS)
        if len(log) and not log.falls:
            return trial.gap, drawn_again
        drawn_again += 1


def _row(trial: Trial, method: str, deployments: Sequence[StepLog]) -> DeploymentRow:
    """Measures of the last of the deployments that a method needs."""
    steps = deployments[-1]
    row: DeploymentRow = {"twin": trial.twin, "seed": trial.seed, "method": method}
    if not len(steps):
        return row | {"steps": 0, "falls": 1}
    found = summarise(steps, trial.reference, method)
    tracked = [StepLog(log.space, (step for step in log.completed() if step.step > 0)) for log in deployments]
    errors = np.concatenate([log.next_state - log.target for log in tracked])
    earlier = sum(map(len, deployments)) - len(errors)  # exploratory and failed hops
    hops = None if found.falls else hops_to_band(errors)
    covered, counted = count_covered(tracked[-1])
    return row | {
        "steps": found.steps,
        "falls": found.falls,
        "error": float(np.linalg.norm(found.rmse / steps.space.state_scale)),
        "rmse": found.rmse.tolist(),
        "transient_rmse": found.transient_rmse.tolist(),
        "steady_rmse": found.steady_rmse.tolist(),
        "hops_to_band": None if hops is None else hops + earlier,
        "covered": covered.tolist(),
        "counted": counted,
    }


def count_covered(steps: StepLog) -> tuple[Array, int]:
    """Number of steps within the predicted 95 % interval, by coordinate (n,), and number of steps with an interval."""
    known = np.isfinite(steps.predicted).all(axis=1) & (steps.std > 0).all(axis=1)
    inside = np.abs(steps.next_state - steps.predicted) <= INTERVAL_95 * steps.std
    return inside[known].sum(axis=0), int(known.sum())

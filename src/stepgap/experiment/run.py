"""A run, finished or in progress: its files and all that follows from them, each part read when it is first used."""

from collections.abc import Callable, Mapping
from functools import cached_property, reduce
from html import escape
from math import isclose, isfinite
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Self, TypedDict, TypeVar, Unpack, final

import numpy as np

from stepgap.base.blas import one_blas_thread
from stepgap.base.errors import InputError, message_of
from stepgap.base.json_data import LARGEST_NUMBER
from stepgap.base.normal import std_interval_95
from stepgap.control.reference import mean_of_known
from stepgap.experiment.deployment import DeploymentController
from stepgap.experiment.displays import load_display
from stepgap.experiment.inputs import load_known, load_priors
from stepgap.experiment.nominal import load_nominal
from stepgap.experiment.settings import Experiment, SettingsFile, experiment_table, read_experiment, read_settings_file
from stepgap.learning.corrected_map import CorrectedMap
from stepgap.learning.learner import Learner
from stepgap.learning.posterior import POSTERIOR
from stepgap.learning.residual import Residual
from stepgap.learning.steps import Steps, as_past
from stepgap.plants.ticks.tick_table import TickTable
from stepgap.records.missing import Missing
from stepgap.records.model_files import model_path, read_model
from stepgap.records.motion_file import Replay
from stepgap.records.steps_csv import digest, ends_with_whole_row, read_step_log, space_of_header, with_context
from stepgap.records.summary import Deployment, NoiseFloor, Summary, read_summary
from stepgap.records.times_file import Times, read_times
from stepgap.robots.entry_points import load_robot
from stepgap.robots.published_result import PublishedResult
from stepgap.robots.robot import Robot
from stepgap.step import Array, StepMap, StepSpace

if TYPE_CHECKING:  # slow imports are made where they are used
    from matplotlib.figure import Figure

_Part = TypeVar("_Part")


class Given(TypedDict, total=False):
    """Parts of a `Run` that are given instead of read, such as the nominal map of a robot without a name."""

    settings: Experiment | Missing
    space: StepSpace
    recorded: Steps
    summary: Summary
    plant: str
    defaults: Mapping[str, Any] | Missing
    nominal: StepMap | Missing
    published: PublishedResult | None
    final: Residual | Missing
    replay: Replay | Missing
    ticks: Mapping[int, TickTable]
    on_replay: Callable[[int, int], None]


@final
class Run:
    """A run folder.

    A part that the folder does not have, or that this version cannot read, is `Missing`, with the reason. What is read
    once is kept: make another object to see the new steps of a run in progress.

    Args:
        given: Parts that are not read, by their names.

    Attributes:
        folder: The run folder.
        replay: Motions to show; None for those of the folder, which `experiment.replay.replay_of` finds.
        ticks: Ticks of deployments as a `TickRecorder` kept them, of which motions are made without a simulation.
        on_replay: Called with the numbers of finished and of all steps while a deployment is simulated again.
    """

    replay: Replay | Missing | None = None
    ticks: Mapping[int, TickTable] = MappingProxyType({})
    on_replay: Callable[[int, int], None] = staticmethod(lambda done, total: None)

    def __init__(self, folder: Path | str, **given: Unpack[Given]):
        if unknown := given.keys() - Given.__annotations__.keys():
            raise TypeError(f"a run has no part {min(unknown)!r}; its parts are {', '.join(Given.__annotations__)}")
        self.folder = Path(folder)
        vars(self).update(given)

    def __repr__(self) -> str:
        try:
            return f"<run in {self.folder}: {self.recorded}>"
        except InputError as error:
            return f"<run in {self.folder}, not readable: {error}>"

    def _repr_html_(self) -> str:
        """What the run achieved, as the top of its report says it: notebooks show it."""
        try:
            return load_display("summary")(self.checked())
        except InputError:
            return escape(repr(self))

    def plot(self) -> "Figure":
        """Draws state and target against the step number, in the first and in the last deployment."""
        return self.figure("tracking")

    def figure(self, name: str) -> "Figure":
        """Draws a figure of the report.

        Args:
            name: Name of its file in `figures/`, such as `tracking`, `commands` or `errors`.

        Raises:
            InputError: There is no such figure of this run; the message has the names of those that there are.
        """
        return load_display("figure")(self, name)

    def checked(self) -> Self:
        """Returns this run, after all of `steps.csv`, `summary.json` and `experiment.toml` was checked.

        Raises:
            InputError: A file is not valid, there is no step, or the files are not of one run; the message names it.
        """
        path = self.folder / "steps.csv"
        steps = self.steps
        if not len(steps):
            raise InputError(f"{path}: no step yet; it must have a header and at least one row below it")
        columns = np.hstack([steps.state, steps.target, steps.next_state, steps.predicted, steps.std])
        if (np.abs(columns[np.isfinite(columns)]) > LARGEST_NUMBER).any() or (steps.std < 0).any():
            raise InputError(
                f"{path}: a state is larger than ±{LARGEST_NUMBER:g} or an std_… negative; both must be in SI units"
            )
        _ = self.summary, self.settings_file
        return self

    def needed(self, part: _Part | Missing) -> _Part:
        """Returns a part of the run.

        Raises:
            InputError: It is missing; the message has the reason.
        """
        if isinstance(part, Missing):
            raise InputError(f"{self.folder}: {part.reason}")
        return part

    @cached_property
    def settings_file(self) -> SettingsFile | Missing:
        """Text and table of `experiment.toml`, which may have settings that this version does not know.

        Raises:
            InputError: It is not a TOML file.
        """
        return read_settings_file(self.folder / "experiment.toml")

    @cached_property
    def settings(self) -> Experiment | Missing:
        """Settings of the experiment."""
        path = self.folder / "experiment.toml"
        if not path.exists():
            return Missing("the folder contains no experiment.toml")
        try:
            return read_experiment(path, recorded=True)
        except InputError as error:
            return Missing(f"the settings are not valid in this version: {error}")

    @property
    def called(self) -> str:
        """Name and note of the run, such as "leg 3: new spring"; empty if it has neither."""
        if isinstance(self.settings, Missing):
            return ""
        return ": ".join(text for text in (self.settings.name, self.settings.note) if text)

    @cached_property
    def robot(self) -> Robot | Missing:
        """The robot of the settings, which knows units and ranges; missing if its state is not that of the steps."""
        if isinstance(self.settings, Missing):
            return self.settings
        robot = self.settings.robot
        if self._has_header and not robot.space.has_names_of(self._header):
            return Missing(f"steps.csv is not of the state and command of robot '{robot.name}' in experiment.toml")
        return robot

    @cached_property
    def space(self) -> StepSpace:
        """State, command and recorded context; if the robot is missing, without units, and bounds have no meaning."""
        if isinstance(self.robot, Missing):
            return self._header
        space = self.needed(self.settings).space
        return with_context(space, self._header.context_names) if self._has_header else space

    @cached_property
    def published(self) -> PublishedResult | None:
        """Published result of the robot; None if there is none, or if the robot is missing."""
        return None if isinstance(self.robot, Missing) else self.robot.published()

    @cached_property
    def plant(self) -> str:
        """Name of the plant that executed the steps, for sentences."""
        if isinstance(self.settings, Missing):
            return "plant of an unknown kind"
        return self.settings.robot.plant_titles.get(self.settings.plant, f"plant '{self.settings.plant}'")

    @cached_property
    def defaults(self) -> Mapping[str, Any] | Missing:
        """Default value of every setting, in nested tables like those of `experiment.toml`."""
        if isinstance(self.settings, Missing):
            return self.settings
        return experiment_table(Experiment(load_robot(self.settings.robot.name)))

    @cached_property
    def recorded(self) -> Steps:
        """All recorded steps, none if only the header was written; a row that is being written is left out.

        Beside `steps` it has the first one of a plant that knows it (`Plant.first_step`), which learning uses.

        Raises:
            InputError: `steps.csv` does not exist or is not valid.
        """
        _ = self._summary_file  # read first, because a run in progress adds steps
        try:
            return read_step_log(self.folder / "steps.csv", self.space)
        except OSError as error:
            raise InputError(f"{message_of(error)}; {self.folder} must be the folder of a run") from None

    @cached_property
    def steps(self) -> Steps:
        """The recorded steps that were planned.

        Raises:
            InputError: `steps.csv` does not exist or is not valid.
        """
        return self.recorded.planned()

    @cached_property
    def cut_off(self) -> bool:
        """Whether the last row of `steps.csv` was not completely written; it is not in `recorded`."""
        return not ends_with_whole_row(self.folder / "steps.csv")

    @cached_property
    def summary(self) -> Summary:
        """Errors of the finished deployments, and versions; the summary of no deployment if there is none yet.

        Raises:
            InputError: `summary.json` is not valid, or not of these steps.
        """
        if isinstance(self._summary_file, InputError):
            raise self._summary_file
        _check_same_run(self._summary_file, self.recorded, self.folder / "summary.json")
        return self._summary_file

    @property
    def versions(self) -> tuple[tuple[str, str], ...]:
        """Versions with which the run was made, even if `summary.json` is not of these steps; none if not known."""
        return () if isinstance(self._summary_file, InputError) else self._summary_file.versions

    @cached_property
    def times(self) -> Times | Missing:
        """How long fits and the choice of commands took, by deployment and part."""
        return read_times(self.folder)

    @cached_property
    def known(self) -> Steps:
        """Steps that were known before the first deployment, numbered as deployments before number 0.

        Raises:
            InputError: The settings are missing, or their file of steps is not valid.
        """
        return as_past(load_known(self.needed(self.settings), self.space))

    @cached_property
    def nominal(self) -> StepMap | Missing:
        """Nominal map."""
        if isinstance(self.robot, Missing):
            return self.robot
        try:
            return load_nominal(self.needed(self.settings)).map
        except InputError as error:
            return Missing(str(error))

    def residual(self, iteration: int) -> Residual | Missing:
        """Residual in `models/` with which a deployment began; a deployment with the nominal map has none."""
        try:
            model = read_model(self.folder, iteration, self.space)
        except (ValueError, OSError) as error:
            return Missing(message_of(error))
        if model is not None:
            return model.residual
        name = model_path(self.folder, iteration).relative_to(self.folder)
        return Missing(f"there is no {name}" if iteration else "deployment 0 used the nominal map")

    @cached_property
    def final(self) -> Residual | Missing:
        """What is learned from all steps, with which a further deployment would begin; that takes seconds."""
        for part in (self.settings, self.nominal):
            if isinstance(part, Missing):
                return part
        try:
            with one_blas_thread():
                return self.learner().learned
        except InputError as error:
            return Missing(str(error))

    def learner(self, iteration: int | None = None) -> Learner:
        """State of learning at the start of a deployment.

        What is learned is read from the run's folder. Of the deployment after the last one the folder has nothing: then
        it is learned from the steps as a further deployment would do, which takes seconds.

        Args:
            iteration: Number of the deployment; None for the one after the last.

        Raises:
            InputError: There is no such deployment, the settings or the nominal map are missing, or the model in the
                folder is not that of this run and its nominal map.
        """
        nominal = self.needed(self.nominal)
        settings = self.needed(self.settings)
        after = max(self.recorded.iterations, default=-1) + 1
        number = after if iteration is None else iteration
        if not 0 <= number <= after:
            raise InputError(f"{self.folder}: has no deployment {number}; it may be 0 to {after}, the next one")
        try:
            model = read_model(self.folder, number, nominal.space, nominal)
        except (ValueError, OSError) as error:
            raise InputError(message_of(error)) from None
        log = Steps(self.recorded.space) + self.known + self.recorded.before(number)
        if model is not None:
            return Learner.restored(nominal, log, settings.learning, number, *model)
        if number < after and len(log):
            raise InputError(f"{self.folder}: there is no models/iteration_{number}.json, so the model is unknown")
        priors = [file.prior for file in load_priors(settings, nominal.space)]
        if number > 0 and (last := self._last_beliefs(number - 1)):
            return last.redeployed(log, priors)
        return Learner.start(nominal, log, settings.learning, number, priors)

    def _last_beliefs(self, iteration: int) -> Learner | None:
        """The learner after a deployment whose beliefs the next one goes on with; None where they are not known."""
        if self.needed(self.settings).learning.residual != POSTERIOR.name:
            return None
        try:
            before = self.learner(iteration)
        except InputError:
            return None
        if before.beliefs is None:
            return None
        return reduce(Learner.after, self.recorded.of_iteration(iteration).completed(), before)

    def corrected(self, iteration: int | None = None) -> CorrectedMap:
        """The map with which a deployment began: nominal map and residual.

        Args:
            iteration: As of `learner`.

        Raises:
            InputError: As of `learner`.
        """
        return self.learner(iteration).step_map()

    def controller(self, iteration: int | None = None) -> DeploymentController:
        """The controller at the start of a deployment, which knows the step that the plant took before the first.

        With the steps of the run, and the targets ahead of each of them, it gives the recorded commands.

        Args:
            iteration: As of `learner`.

        Raises:
            InputError: As of `learner`.
        """
        learner = self.learner(iteration)
        controller = DeploymentController.start(learner, self.needed(self.settings).control)
        steps = self.recorded.of_iteration(learner.iteration)
        return reduce(DeploymentController.after, steps.selected(steps.unplanned), controller)

    @property
    def deployments(self) -> tuple[Deployment, ...]:
        """Finished deployments in ascending order."""
        return self.summary.deployments

    @property
    def noise_floor(self) -> Array:
        """Noise floor, the standard deviation of repeated steps, NaN where unknown; shape (n,)."""
        return self._floors.any_phase

    @property
    def noise_floor_same_phase(self) -> Array:
        """The same at one phase, so that only the noise differs, NaN where unknown; shape (n,)."""
        return self._floors.same_phase

    @property
    def noise_floor_interval(self) -> Array:
        """Ends of the 95 % confidence interval of the noise floor, NaN where unknown; shape (2, n)."""
        return std_interval_95(self._floors.any_phase, self._floors.any_phase_freedom)

    @property
    def noise_floor_same_phase_interval(self) -> Array:
        """Ends of the 95 % confidence interval of that at one phase, NaN where unknown; shape (2, n)."""
        return std_interval_95(self._floors.same_phase, self._floors.same_phase_freedom)

    @property
    def noise_floor_steps(self) -> int:
        """Number of steps from which the noise floor was computed; 0 if it is not known."""
        return self._floors.steps

    @property
    def shown_iterations(self) -> list[int]:
        """Deployments that figures show: the finished ones or, while there are none, those with steps."""
        return [deployment.iteration for deployment in self.deployments] or self.steps.iterations

    def residual_name(self, iteration: int) -> str | None:
        """Name of the residual of a deployment, `none` for the nominal map; None where it is not known.

        Of an unfinished deployment 0 it is known as long as its predictions have no standard deviation: they are those
        of the nominal map.
        """
        names = {deployment.iteration: deployment.residual for deployment in self.deployments}
        nominal = iteration == 0 and not self.steps.of_iteration(0).std.any()
        return names.get(iteration, "none" if nominal else None)

    @property
    def has_unsaved_residual(self) -> bool:
        """Whether deployment 0 is the last one and learned from the nominal map on: no file has what it learned."""
        last = self.shown_iterations[-1]
        settings = None if isinstance(self.settings, Missing) else self.settings
        warm = self.summary.warm_start or (settings and settings.warm_start)
        return last == 0 and self.residual_name(0) != "none" and not warm

    @property
    def compared_result(self) -> PublishedResult | None:
        """The published result if the run has its reference, so that its errors can be compared; else None."""
        incomplete = {deployment.iteration for deployment in self.deployments if deployment.failed_steps} | set(
            self.unfinished
        )
        tracked = self.published is not None and all(
            self.published.is_tracked_by(self.steps.of_iteration(number).tracking().target, number not in incomplete)
            for number in self.steps.iterations
        )
        return self.published if tracked else None

    @property
    def unfinished(self) -> dict[int, int]:
        """Number of recorded steps of each deployment that is not in `summary.json`."""
        finished = {deployment.iteration for deployment in self.deployments}
        return {
            number: len(self.steps.of_iteration(number)) for number in self.steps.iterations if number not in finished
        }

    @property
    def _has_header(self) -> bool:
        path = self.folder / "steps.csv"
        return path.is_file() and path.stat().st_size > 0

    @cached_property
    def _header(self) -> StepSpace:
        """Names of state and command in the header of `steps.csv`."""
        try:
            return space_of_header(self.folder / "steps.csv")
        except FileNotFoundError as error:
            raise InputError(f"{error.filename}: no such file; {self.folder} must be the folder of a run") from None
        except (ValueError, OSError) as error:
            raise InputError(f"{message_of(error)}; {self.folder} must be the folder of a run") from None

    @cached_property
    def _summary_file(self) -> Summary | InputError:
        """Content of `summary.json`, which may be of other steps, or why it cannot be read."""
        try:
            return read_summary(self.folder / "summary.json", self.space.state_names)
        except (ValueError, OSError) as error:
            return InputError(message_of(error))

    @property
    def _floors(self) -> NoiseFloor:
        return self.summary.noise_floor or NoiseFloor.unknown(len(self.space.state))


def load_run(folder: Path | str) -> Run:
    """Reads a run whose settings, nominal map and steps are all there.

    Raises:
        InputError: It is not a run, or a file in it is not valid; the message names it.
    """
    run = Run(folder)
    for part in (run.settings, run.robot, run.nominal):
        run.needed(part)
    _ = run.steps
    return run


def _check_same_run(summary: Summary, steps: Steps, path: Path) -> None:
    """Raises InputError unless the summary describes these steps, or the first of them."""
    for deployment in summary.deployments:
        rows = steps.of_iteration(deployment.iteration).planned()
        recorded = len(rows)
        failed = rows.failed_steps
        if (recorded, failed) != (deployment.steps, deployment.failed_steps):
            raise InputError(
                f"{path}: deployment {deployment.iteration} has {deployment.steps} steps, {deployment.failed_steps} of "
                f"them failed, in steps.csv {recorded} and {failed}; both must be of the same run"
            )
    if summary.steps_sha256 and summary.steps_sha256 != digest(steps.before(len(summary.deployments))):
        raise InputError(f"{path}: steps.csv was changed after it was written; both must be of the same run")
    for deployment in summary.deployments:
        _check_rmse(deployment, steps, path)


def _check_rmse(deployment: Deployment, steps: Steps, path: Path) -> None:
    """Raises InputError unless the RMSE of a deployment is that of its steps; one that is not known is not checked."""
    errors = steps.of_iteration(deployment.iteration).tracking_errors()
    if not len(errors):
        return
    of_steps = np.sqrt(mean_of_known(errors**2))
    for name, error, computed in zip(steps.space.state_names, deployment.rmse, of_steps, strict=True):
        if isfinite(error) and not isclose(error, computed, rel_tol=1e-6):
            raise InputError(
                f"{path}: rmse of {name} of deployment {deployment.iteration} is {error:.6g}, but that of its steps in "
                f"steps.csv is {computed:.6g}; both must be of the same run"
            )

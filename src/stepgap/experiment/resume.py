"""Resuming an interrupted run: the steps of a deployment come from its record, or the plant takes them."""

from collections import deque
from collections.abc import Callable
from contextlib import closing, suppress
from pathlib import Path
from typing import Self

from stepgap.base.files import create, read_bounded
from stepgap.experiment.deployment import ExecutedSteps
from stepgap.learning.learner import Learner
from stepgap.learning.steps import Steps
from stepgap.records.model_files import Model, read_model, write_model
from stepgap.records.steps_csv import LARGEST_STEPS_FILE, RecordError, StepWriter, digest
from stepgap.records.summary import Deployment, NoiseFloor, OtherSchema, Summary, WarmStart, read_summary, write_summary
from stepgap.step import StepSpace

_REMEDY = "resume with the record, settings, versions and machine that it was started with"
"""Remedy when the recorded steps are not those of this experiment."""


class Recording:
    """The record of a run in `steps.csv`, to which every step of every deployment is added once.

    Deployments that `summary.json` verifies by its digest are taken as they are recorded. A plant that takes the same
    steps again begins the next one from its seed: the rows of an interrupted deployment are removed and written again.
    If the summary is lost, all deployments are, and the rows of before are kept in `steps.csv.before`.
    Any other plant, such as hardware, keeps them as a deployment that is not continued. Use it as a context manager,
    and call `steps` for one deployment after the other.

    Attributes:
        space: As given, but with the context that the file has: an older file may have less, or more.

    Args:
        past: Steps that were known before the run.
        replays: Whether a plant takes the same steps again.

    Raises:
        RecordError: The file is not a step log of this space, another process is writing it, the summary is that of
            another version or of other steps, or steps that it counts are lost and cannot be taken again.
        OSError: The file cannot be read or written.
    """

    def __init__(self, folder: Path, space: StepSpace, seed: int, past: Steps, replays: bool):
        self._path = folder / "steps.csv"
        self._replays = replays
        self._writer = StepWriter(self._path, space)
        self.space = self._writer.space
        self._recorded = deque(self._writer.recorded)
        self._begun = frozenset(self._writer.recorded.iterations)
        try:
            self._summary = _verified_summary(folder, self._writer.recorded, seed, past, replays)
        except RecordError:
            self._writer.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc_info: object) -> None:
        self._writer.close()

    def steps(self, iteration: int, execute: Callable[[], ExecutedSteps]) -> ExecutedSteps:
        """Yields the steps of a deployment, each after it is on disk.

        Args:
            execute: Executes the deployment from its beginning.
        """
        if self._is_kept(iteration):
            while self._recorded and self._recorded[0].iteration == iteration:
                yield self._recorded.popleft()
            return
        if self._recorded and self._recorded[-1].iteration > iteration:
            # Finished deployments are taken again, since the summary that counted them is lost: their rows are kept.
            with suppress(FileExistsError):
                create(self._path.with_name("steps.csv.before"), read_bounded(self._path, LARGEST_STEPS_FILE))
        self._writer.cut(len(self._writer.recorded) - len(self._recorded))
        self._recorded.clear()
        with closing(execute()) as executed:
            for logged in executed:
                self._writer.append(logged)
                yield logged

    def _is_kept(self, iteration: int) -> bool:
        """Whether the steps of a deployment are taken as they are recorded."""
        partial = not self._replays and bool(self._recorded) and self._recorded[0].iteration == iteration
        return partial or iteration < len(self._summary.deployments)

    def write_model(self, learner: Learner) -> None:
        """Writes the model with which a deployment begins; that of steps that are kept is part of the record.

        A model that is fitted again differs in its last bits with other versions or on another machine.

        Raises:
            RecordError: The model of recorded steps corrects another nominal map.
            OSError: The file cannot be read or written.
        """
        folder = self._path.parent
        iteration = learner.iteration
        nominal = learner.nominal
        if iteration in self._begun and _has_intact_model(folder, iteration, nominal.space):
            try:
                read_model(folder, iteration, nominal.space, nominal)
            except ValueError as error:
                raise RecordError(f"{error}; {_REMEDY}, or start another run by --warm-start {folder}") from None
            if self._is_kept(iteration):
                return
        write_model(folder, iteration, Model(learner.learned, learner.beliefs), nominal)

    def write_summary(self, summary: Summary) -> None:
        """Writes `summary.json`, unless there are recorded steps of later deployments, whose summary it would remove.

        Raises:
            OSError: It cannot be written.
        """
        if not self._recorded:
            write_summary(self._path.with_name("summary.json"), summary, self._writer.recorded.space.state_names)

    def deployment(self, iteration: int) -> Deployment | None:
        """Outcome of a deployment that `summary.json` counts; None of another."""
        finished = self._summary.deployments
        return finished[iteration] if iteration < len(finished) else None

    def check_finished(self) -> None:
        """Raises RecordError if there are recorded steps after the last deployment."""
        if self._recorded:
            raise RecordError(f"{self._path}: it has steps after the last deployment of this experiment; {_REMEDY}")

    def measured_noise_floor(self, deployments: int) -> NoiseFloor | None:
        """Noise floor that was measured after this number of deployments; None if it was not."""
        summary = self._summary
        is_measured = summary.noise_floor_measured and len(summary.deployments) == deployments
        return summary.noise_floor if is_measured else None


def warm_start_of(past: Steps) -> WarmStart | None:
    """Entry of `summary.json` on the steps known before a run; None if there were none."""
    return WarmStart(len(past), digest(past)) if len(past) else None


def _has_intact_model(folder: Path, iteration: int, space: StepSpace) -> bool:
    """Whether the folder has the model of a deployment, and it is not damaged."""
    try:
        return read_model(folder, iteration, space) is not None
    except ValueError:
        return False


def _verified_summary(folder: Path, recorded: Steps, seed: int, past: Steps, replays: bool) -> Summary:
    """The summary if it is of this experiment and its recorded steps; an empty one where it must be written again."""
    try:
        summary = read_summary(folder / "summary.json", recorded.space.state_names)
    except OtherSchema as error:
        raise RecordError(f"{error}; continue with the version of StepGap that wrote it") from None
    except (OSError, ValueError):
        return Summary()  # damaged, or that of something else
    deployments = summary.deployments
    done = recorded.before(len(deployments))
    if (summary.seed, summary.steps_sha256, summary.warm_start) == (seed, digest(done), warm_start_of(past)):
        return summary
    counted = sum(deployment.steps for deployment in deployments)
    lost = len(done.planned()) < counted
    if lost and not replays:
        raise RecordError(
            f"{folder}: summary.json has {len(deployments)} deployments with {counted} steps, but steps.csv only "
            f"{len(done.planned())} steps; restore steps.csv from a copy, or start another run"
        )
    if deployments and replays and not lost:
        raise RecordError(
            f"{folder / 'steps.csv'}: its steps are not those that summary.json counts, or are of another seed or "
            f"other known steps; {_REMEDY}"
        )
    return Summary()

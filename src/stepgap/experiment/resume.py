"""Where the steps of a deployment come from when a run was interrupted: its record, a replay, or the plant."""

from collections import deque
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Self

from stepgap.experiment.deployment import Steps
from stepgap.learning.step_log import LoggedStep, StepLog
from stepgap.records.steps_csv import RecordError, StepWriter, digest, row_of
from stepgap.records.summary import Summary, WarmStart, read_summary
from stepgap.step import Array, StepSpace

SAME_AGAIN = "resume with the record, settings, versions and machine that it was started with"
"""What to do when a replay does not give the recorded steps."""


class Recording:
    """The record of a run in `steps.csv`, to which every step of every deployment is added once.

    Deployments that `summary.json` verifies by its digest are taken as they are recorded. What was recorded after them
    is executed again, from the same seed, and must give the same steps; new steps are written. To be used as a context
    manager, and to be asked for deployment after deployment.

    Args:
        folder: The run folder.
        space: Names of state and command.
        seed: Random seed of the run.
        past: Steps that were known before the run.
        replays: Whether a plant takes the same steps again. If not, as on hardware, a deployment of which steps are
            recorded is taken as it is, and is over.

    Raises:
        RecordError: The file is not a step log of this space, or another process is writing it.
        OSError: It cannot be read or written.
    """

    def __init__(self, folder: Path, space: StepSpace, seed: int, past: StepLog, replays: bool):
        self._path, self._replays = folder / "steps.csv", replays
        self._writer = StepWriter(self._path, space)
        self._recorded = deque(self._writer.recorded)
        self._summary = _verified_summary(folder / "summary.json", self._writer.recorded, seed, past)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc_info: object) -> None:
        self._writer.close()

    @property
    def caught_up(self) -> bool:
        """Whether every recorded step has been passed on."""
        return not self._recorded

    def steps(self, iteration: int, execute: Callable[[], Steps]) -> Steps:
        """The steps of a deployment, each after it is on disk.

        Args:
            iteration: Number of the deployment.
            execute: Executes it from its beginning.

        Raises:
            RecordError: The deployment, executed again, does not give the recorded steps.
        """
        kept = not self._replays and bool(self._recorded) and self._recorded[0].iteration == iteration
        if kept or iteration < len(self._summary.deployments):
            while self._recorded and self._recorded[0].iteration == iteration:
                yield self._recorded.popleft()
            return
        with closing(execute()) as executed:
            for logged in executed:
                if self._recorded:
                    self._check_same(self._recorded.popleft(), logged)
                else:
                    self._writer.append(logged)
                yield logged

    def check_finished(self) -> None:
        """Raises RecordError if there are recorded steps after the last deployment."""
        if self._recorded:
            raise RecordError(f"{self._path}: it has steps after the last deployment of this experiment; {SAME_AGAIN}")

    def measured_noise_floor(self, deployments: int) -> Array | None:
        """Noise floor that was measured after this number of deployments; None if it was not."""
        known = self._summary
        return known.noise_floor if known.noise_floor_measured and len(known.deployments) == deployments else None

    def _check_same(self, known: LoggedStep, replayed: LoggedStep) -> None:
        """Raises RecordError unless the replayed step is the recorded one to the last bit."""
        if row_of(known) != row_of(replayed):
            raise RecordError(
                f"{self._path}: replaying deployment {replayed.iteration} gave another step {replayed.step} than the "
                f"one recorded; {SAME_AGAIN}"
            )


def warm_start_of(past: StepLog) -> WarmStart | None:
    """What `summary.json` says of the steps known before a run; None if there were none."""
    return WarmStart(len(past), digest(past)) if len(past) else None


def _verified_summary(path: Path, recorded: StepLog, seed: int, past: StepLog) -> Summary:
    """The summary, if its digest is that of the recorded steps of its deployments; else an empty one."""
    try:
        summary = read_summary(path, recorded.space.state_names)
    except (OSError, ValueError):
        return Summary()  # none, or not ours: it will be written again
    done = StepLog(recorded.space, (logged for logged in recorded if logged.iteration < len(summary.deployments)))
    found = (summary.seed, summary.steps_sha256, summary.warm_start)
    return summary if found == (seed, digest(done), warm_start_of(past)) else Summary()

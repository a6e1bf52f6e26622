"""All data of a run, finished or in progress: steps and motion.

Steps are read from the run folder. Motion comes from a ring of ticks while the run is in progress, from the
tick logs of a rig, or otherwise from a repeated simulation of the deployment.
"""

from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from threading import Event, Thread

import numpy as np

from stepgap.base.errors import InputError, message_of
from stepgap.experiment.replay import ground_of, kinematics_of, logged_ticks, replayed_steps
from stepgap.experiment.run import Run
from stepgap.learning.steps import LoggedStep
from stepgap.plants.ticks.tick_ring import TickRing
from stepgap.plants.ticks.tick_table import TickTable
from stepgap.records.missing import Missing
from stepgap.robots.scene import GroundPieces, Kinematics, Motion
from stepgap.step import Array
from stepgap.view.live import VIEW_INTERVAL

STILL = 0.75  # Displayed duration of a step with unknown motion [s]


class Source:
    """Data of a run folder, and of the ring of a run in progress.

    Args:
        ring: Ticks of a run in progress, each with its deployment and step; without a ring, the motion is read or
            simulated again.

    Attributes:
        settings: Settings of the experiment.
        space: State and command of its steps.
        kinematics: How its robot is drawn, as a simulated plant where its motion is not known; None if it is not.

    Raises:
        InputError: It is not a run folder, or it has no step and no run is adding one.
    """

    def __init__(self, folder: Path, ring: TickRing | None = None):
        self.folder = folder
        self._ring = ring
        self._run = Run(folder)
        self.settings = self._run.needed(self._run.settings)
        self.nominal = self._run.needed(self._run.nominal)
        self.space = self.nominal.space
        kinematics = kinematics_of(self._run)
        self._missing = kinematics if isinstance(kinematics, Missing) else None
        self._has_motion = self._missing is None
        self.kinematics = self.settings.robot.kinematics() if isinstance(kinematics, Missing) else kinematics
        self._size = -1
        self._steps: dict[int, list[LoggedStep]] = {}
        self._motion: dict[int, list[Motion | None]] = {}
        self._loaders: dict[int, Thread] = {}
        self._closed = Event()
        self._ticks: dict[tuple[int, int], list[np.ndarray]] = defaultdict(list)
        self._grounds: dict[tuple[int, int], GroundPieces | None] = {}
        self.poll()
        if not self._steps and ring is None:
            raise InputError(f"{folder / 'steps.csv'}: no step yet; try again when there are some")

    @property
    def missing_motion(self) -> Missing | None:
        """Reason why some motion is not available; None if there is none."""
        return self._missing

    @property
    def iterations(self) -> list[int]:
        """Numbers of the deployments in ascending order."""
        return sorted(self._steps)

    def steps(self, iteration: int) -> list[LoggedStep]:
        """Recorded steps of a deployment that were planned; the motion before them is that of its start."""
        return self._steps.get(iteration, [])

    def motion_count(self, iteration: int) -> int:
        """Number of motions of a deployment: the one of the start, and those of its steps."""
        return 1 + len(self.steps(iteration))

    def motion(self, iteration: int, number: int) -> Motion | None:
        """Motion of a step, None while it is being computed; if it is not available, the robot rests at the section.

        Args:
            number: 0 for the start, k for the k-th recorded step of the deployment.
        """
        motions = self._motion.get(iteration, [])
        steps = self.steps(iteration)
        if number < len(motions) and (motion := motions[number]):
            return motion
        is_loading = iteration in self._loaders and self._loaders[iteration].is_alive()
        if is_loading or not steps:
            return None
        # The robot rests where the step ended or, before the first step and where a step failed, where it began.
        record = steps[min(max(number, 1), len(steps)) - 1].record
        has_ended = number > 0 and np.isfinite(record.next_state).all()
        return self._still(record.next_state if has_ended else record.state)

    def want(self, iteration: int) -> None:
        """Starts to load the motion of a deployment, unless it is known or comes through the ring."""
        from_ring = self._ring is not None and iteration >= max(self._steps, default=0)
        if iteration in self._motion or from_ring or self.kinematics is None or not self._has_motion:
            return
        self._motion[iteration] = []
        load = self._simulate if self.settings.simulated else self._read_log
        self._loaders[iteration] = Thread(target=self._load, args=(iteration, load), daemon=True)
        self._loaders[iteration].start()

    def await_motion(self, iteration: int) -> None:
        """Waits until the motion of a deployment is loaded."""
        if iteration in self._loaders:
            self._loaders[iteration].join()

    def close(self) -> None:
        """Stops loading motion; a program that ends while a thread is loading would crash."""
        self._closed.set()
        for loader in self._loaders.values():
            loader.join()

    def ground(self, iteration: int) -> GroundPieces | None:
        """The uneven ground of a deployment, as far as it is known; None if it is level."""
        # That of a simulated robot is known from the start; elsewhere every step shows more of it.
        version = iteration, 0 if self.settings.simulated else len(self.steps(iteration))
        if version not in self._grounds and self.kinematics:
            self._grounds[version] = ground_of(self._run, iteration, self.kinematics.scene)
        return self._grounds.get(version)

    def poll(self) -> bool:
        """Reads new data; returns whether there were new steps."""
        grown = self._read_steps()
        if self._ring:
            self._drain(self._ring)
        return grown

    def _still(self, state: Array) -> Motion:
        """The robot at rest in a state at the section; a pause if it is not drawn."""
        points = np.zeros((1, 3))
        feet = 0
        signals = 0
        if self.kinematics:
            scene = self.kinematics.scene
            points = self.kinematics.at_section(state)
            feet = len(scene.feet)
            signals = len(scene.signals)
        positions = np.stack([points, points])
        at_rest = np.zeros(2)
        return Motion(np.array([0.0, STILL]), at_rest, positions, np.zeros((2, feet)), at_rest, np.zeros((2, signals)))

    def _read_steps(self) -> bool:
        try:
            size = (self.folder / "steps.csv").stat().st_size
        except FileNotFoundError:
            return False
        except OSError as error:
            raise InputError(message_of(error)) from None
        if size == self._size:
            return False
        self._run = Run(self.folder, settings=self.settings, space=self.space, nominal=self.nominal)
        self._size = size
        steps = defaultdict(list)
        for logged in self._run.steps:
            steps[logged.iteration].append(logged)
        self._steps = dict(steps)
        return True

    def _drain(self, ring: TickRing) -> None:
        """Takes the ticks out of the ring; a step is complete when it is recorded or a later one has begun."""
        rows = ring.drain()
        for row in rows:
            self._ticks[int(row[0]), int(row[1])].append(row[2:])
        newest = max(self._ticks, default=(0, 0))
        for iteration, number in sorted(self._ticks):
            if number < self.motion_count(iteration) and ((iteration, number) < newest or number > 0):
                rows = np.array(self._ticks.pop((iteration, number)))
                motions = self._motion.setdefault(iteration, [])
                motions.extend([None] * (number + 1 - len(motions)))
                if self.kinematics:
                    numbered = {**self.kinematics.units, "step": ""}
                    table = TickTable(numbered, np.column_stack([rows, np.full(len(rows), float(number))]))
                    motions[number] = self.kinematics.motion(table)

    def _load(self, iteration: int, load: Callable[[int, list[Motion | None], Kinematics], None]) -> None:
        """Loads the motion step by step; the page shows errors."""
        assert self.kinematics
        try:
            load(iteration, self._motion[iteration], self.kinematics)
        except (ValueError, OSError) as error:
            self._missing = Missing(str(error))

    def _simulate(self, iteration: int, motions: list[Motion | None], kinematics: Kinematics) -> None:
        for table in replayed_steps(self._run, iteration, kinematics.every(VIEW_INTERVAL)):
            motions.append(kinematics.motion(table) if len(table) else None)
            if self._closed.is_set():
                return

    def _read_log(self, iteration: int, motions: list[Motion | None], kinematics: Kinematics) -> None:
        steps = self.steps(iteration)
        ticks = logged_ticks(self._run, iteration)
        for step in range(steps[0].step - 1, steps[-1].step + 1):
            rows = ticks.rows[ticks["step"] == step][:: kinematics.every(VIEW_INTERVAL)]
            motions.append(kinematics.motion(TickTable(ticks.units, rows)) if len(rows) else None)

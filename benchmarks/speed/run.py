"""`benchmarks.speed run`: how the CPU time of a default run is divided.

All times are CPU times, not wall-clock times, so that other programs on the machine change them little. A timer samples
every millisecond which part of the program is running, which gives the parts of the run. The share of `mj_step` in a
tick is measured afterwards: some hops are made alternately with the whole loop and, from the record, with `mj_step`
alone.
"""

# pyright: reportAttributeAccessIssue=false
# (MuJoCo ships no types for its compiled part.)

import signal
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from time import process_time, thread_time
from types import FrameType
from typing import Any

import numpy as np

from benchmarks.speed.timing import machine
from stepgap.base.compiled import as_written
from stepgap.experiment.recorders import TickRecorder
from stepgap.experiment.settings import Experiment
from stepgap.plants.compiled_rig import Rows
from stepgap.plants.rig_plant import RigPlant
from stepgap.plants.tick_control import Mode
from stepgap.robots.hopper.robot import as_hopper
from stepgap.robots.hopper.tick.hop_control import HopperControl
from stepgap.robots.hopper.tick.hop_tick import tick
from stepgap.robots.hopper.tick.tick_row import TICK_COLUMN
from stepgap.robots.hopper.twin.devices import drive
from stepgap.robots.hopper.twin.physics import move
from stepgap.robots.hopper.twin.twin import Twin

_SAMPLING_PERIOD = 1e-3
"""CPU time between two samples [s]."""

HOPPING, REST = "hopping", "rest"
LOADING = "loading"
PARTS = (
    (LOADING, ("importlib", "numba/core/")),
    ("report", ("stepgap/report/",)),
    (HOPPING, ("stepgap/plants/", "stepgap/robots/hopper/twin/twin")),
    ("learning", ("stepgap/learning/learner",)),
    ("planning", ("stepgap/control/",)),
    ("files", ("stepgap/learning/steps", "stepgap/records/", "stepgap/base/files", "stepgap/base/output_files")),
    ("learning", ("stepgap/learning/",)),
)
"""Parts of a run, with patterns of the files whose functions belong to them, in order of precedence."""

TURNS, HOPS = 8, 10
"""Number of turns of loop and `mj_step`, and number of hops in a turn."""

_EVERY = 10
"""Interval of the ticks that a run keeps for its report."""

_STEP = int(Mode.STEP)

COMMAND = np.array([-7.0, -6.0])
"""Command during the measurement of the cost of a tick [N]."""

PACKAGES = ("stepgap", "numpy", "numba", "mujoco")
"""Packages whose versions are part of the result."""


@dataclass(frozen=True)
class TickCost:
    """Mean CPU time of one tick of hopping [µs].

    Attributes:
        loop: The whole tick, as in a deployment.
        physics: `mj_step` alone.
        control: One call of the control tick.
    """

    loop: float
    physics: float
    control: float


class Sampler:
    """Divides CPU time [s] between the first of `PARTS` to which one of the running functions belongs.

    A sample stands for the time since the last one, because a signal waits until compiled code returns to Python.
    """

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._last = 0.0
        self._names: dict[str, list[str]] = {}

    @contextmanager
    def running(self) -> Iterator[None]:
        """Samples after every millisecond of CPU time."""
        before, self._last = signal.signal(signal.SIGPROF, self._sample), process_time()
        signal.setitimer(signal.ITIMER_PROF, _SAMPLING_PERIOD, _SAMPLING_PERIOD)
        try:
            yield
        finally:
            signal.setitimer(signal.ITIMER_PROF, 0)
            signal.signal(signal.SIGPROF, before)

    def _sample(self, _number: int, frame: FrameType | None) -> None:
        files = set[str]()
        while frame:
            files.add(frame.f_code.co_filename)
            frame = frame.f_back
        part, now = self._part(files), process_time()
        self.seconds[part] = self.seconds.get(part, 0.0) + now - self._last
        self._last = now

    def _part(self, files: set[str]) -> str:
        for part, patterns in PARTS:
            if any(pattern in file for file in files for pattern in patterns):
                return part
        return REST


class RecordedTwin(Twin):
    """A twin that records the inputs of MuJoCo at every tick."""

    def connect(self) -> None:
        """Puts the robot into its starting pose, and starts a recording."""
        super().connect()
        self.record()

    def record(self) -> None:
        """Starts a recording at the present motion."""
        self.start, self.given = self.fork(np.random.default_rng(0)), list[tuple[float, ...]]()

    @property
    def ticks(self) -> int:
        """Number of ticks since the start of the recording."""
        return round((self._data.time - self.start._data.time) / self.sensor_model.tick)

    def keep(self, rows: Rows, _step: int) -> None:
        """Records the inputs of a tick at its end, when they are still in memory."""
        (row,) = rows
        applied = (row[TICK_COLUMN.applied_1], row[TICK_COLUMN.applied_2])
        self.given.append((*applied, *self._views.force[self._motors], self._views.ground[2]))

    def bare_time(self) -> float:
        """CPU time of drives and `mj_step` over the recorded ticks [s]; asserts that the motion is the same."""
        twin = self.start.fork(np.random.default_rng(0))
        given = np.array(self.given)
        _repeat_physics(twin._devices, twin._views, twin._physics, given[:0])  # compiles
        begin = thread_time()
        _repeat_physics(twin._devices, twin._views, twin._physics, given)
        spent = thread_time() - begin
        assert np.array_equal(twin._data.qpos, self._data.qpos), "the recorded ticks must reproduce the motion"
        return spent


@as_written
def _repeat_physics(devices, views, physics, given):
    """Moves a twin by recorded torques, their noise and heights of the ground."""
    rig = devices[0]
    silence = np.zeros(2)
    for now in given:
        drive(devices, now[0], now[1], silence, views)
        views.force[rig.motor_1], views.force[rig.motor_2], views.ground[2] = now[2], now[3], now[4]
        move(devices, views, physics)


def tick_cost(settings: Experiment) -> TickCost:
    """Cost of a tick of hopping with the twin of the settings, including all that a run does in a tick."""
    hopper = as_hopper(settings.robot, "ticks are timed")
    control = hopper.control()
    twin = RecordedTwin(hopper.parameters, hopper.gap, np.random.default_rng(settings.seed))
    plain = RigPlant(twin, control, TickRecorder(control.units, _EVERY).on_ticks)
    recorded = RigPlant(twin, control, twin.keep, at_once=1)
    costs = []
    for _ in range(TURNS):
        loop = _hopping_time(plain, twin)
        _hopping_time(recorded, twin)
        costs.append((loop, twin.bare_time() / twin.ticks))
    loop, physics = np.median(costs, axis=0) * 1e6
    return TickCost(float(loop), float(physics), _control_cost(control, twin))


def _hopping_time(plant: RigPlant, twin: RecordedTwin) -> float:
    """Mean CPU time of a tick over some hops [s]."""
    with plant:
        plant.start()
        twin.record()
        begin = thread_time()
        for _ in range(HOPS):
            plant.take_step(COMMAND)
        return (thread_time() - begin) / twin.ticks


def _control_cost(robot_control: HopperControl, twin: Twin) -> float:
    """CPU time of a control tick in compiled code, with the readings of some hops; smallest of several rounds [µs]."""
    blocks, spent = list[Rows](), []
    with RigPlant(twin, robot_control, lambda rows, step: blocks.append(rows)) as plant:
        plant.start()
        for _ in range(HOPS):
            plant.take_step(COMMAND)
    rows = np.concatenate(blocks)
    for _ in range(5):
        memory = robot_control.control(twin).memory
        begin = thread_time()
        _repeat_ticks(memory, rows, tuple(COMMAND))
        spent.append(thread_time() - begin)
    return min(spent) / len(rows) * 1e6


@as_written
def _repeat_ticks(memory, rows, command):
    """Computes the ticks of a log once more."""
    settings, state, row = memory
    for i in range(len(rows)):
        now, before = rows[i], rows[max(i - 1, 0)]
        tick(
            settings, state, row, now[TICK_COLUMN.time], 0.0, now[TICK_COLUMN.motor_1], now[TICK_COLUMN.motor_2],
            now[TICK_COLUMN.boom_horizontal], now[TICK_COLUMN.boom_vertical], now[TICK_COLUMN.contact_force],
            False, False, 0, False, _STEP, 1.0, command[0], command[1], before[TICK_COLUMN.applied_1],
            before[TICK_COLUMN.applied_2],
        )  # fmt: skip


def bench_run(settings: Experiment, run: Callable[[], object]) -> dict[str, Any]:
    """Measures how the CPU time of a run is divided.

    Args:
        settings: Settings of the run.
        run: Runs it, report included.

    Returns:
        CPU time of the parts [s] and of a tick [µs], ratios to `mj_step` alone, and the machine. The ratios do not
        include loading, which includes compilation in the first run on a machine.
    """
    sampler, begin = Sampler(), process_time()
    with sampler.running():
        run()
    total, sampled = process_time() - begin, sum(sampler.seconds.values())
    seconds = {part: total * share / sampled for part, share in sampler.seconds.items()}
    cost = tick_cost(settings)
    hopping = seconds.pop(HOPPING, 0.0)
    physics, control = (hopping * part / cost.loop for part in (cost.physics, cost.control))
    parts = {"physics": physics, "control tick": control, "rest of the twin": hopping - physics - control}
    return {
        "seconds": {**parts, **{part: seconds.get(part, 0.0) for part in ("planning", "learning", "files", "report")}}
        | {part: seconds.get(part, 0.0) for part in (LOADING, REST)},
        "total": total,
        "tick": asdict(cost),
        "hopping_to_physics": cost.loop / cost.physics,
        "run_to_physics": (total - seconds.get(LOADING, 0.0)) / physics,
        "machine": machine(PACKAGES),
    }


def describe_run(result: Mapping[str, Any]) -> str:
    """The result as a text table."""
    total, cost = result["total"], result["tick"]
    lines = [f"{part:18} {seconds:7.2f} s  {seconds / total:6.1%}" for part, seconds in result["seconds"].items()]
    return "\n".join(
        [
            *lines,
            f"{'total':18} {total:7.2f} s",
            f"A tick of 1 ms takes {cost['loop']:.1f} µs: mj_step {cost['physics']:.1f} µs, the control tick "
            f"{cost['control']:.2f} µs.",
            f"Hopping takes {result['hopping_to_physics']:.2f} times as long as its mj_step calls alone, "
            f"the whole run without loading {result['run_to_physics']:.2f} times.",
        ]
    )

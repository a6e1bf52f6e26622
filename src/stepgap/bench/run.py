"""`stepgap bench run`: where the processor's time of a default run goes.

All times are of the processor, not of the clock, so that other programs on the machine change them little. A timer
looks every millisecond which part of the program is running, which gives the parts of the run. What `mj_step` takes of
a tick is measured afterwards: some hops are made with the whole loop and, as recorded, with `mj_step` alone, by turns.
"""

# pyright: reportAttributeAccessIssue=false
# (MuJoCo ships no types for its compiled part.)

import signal
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from copy import copy
from dataclasses import asdict, dataclass
from time import process_time, thread_time
from types import FrameType
from typing import Any

import mujoco
import numpy as np

from stepgap.bench.timing import machine
from stepgap.experiment.settings import Experiment
from stepgap.experiment.tick_recorder import TickRecorder
from stepgap.plants.rig_plant import RigPlant
from stepgap.plants.tick_control import Mode, Order
from stepgap.rigs.rig import HEALTHY
from stepgap.robots.hopper.hop_control import HopControl, HopperControl
from stepgap.robots.hopper.twin.twin import Twin

_LOOK_EVERY = 1e-3
"""Processor time between two looks at what is running [s]."""

HOPPING, REST = "hopping", "rest"
LOADING = "loading"
PARTS = (
    (LOADING, ("importlib", "numba/core/")),
    ("report", ("stepgap/report/", "stepgap/cli/run_report")),
    (HOPPING, ("stepgap/plants/", "stepgap/robots/hopper/twin/twin")),
    ("learning", ("stepgap/learning/learner",)),
    ("planning", ("stepgap/control/",)),
    ("files", ("stepgap/learning/step_log", "stepgap/records/", "stepgap/base/files", "stepgap/base/output_files")),
    ("learning", ("stepgap/learning/",)),
)
"""Parts of a run by the files one of whose functions is running, in the order in which they are looked for."""

TURNS, HOPS = 8, 10
"""How often loop and `mj_step` take turns, and hops in a turn."""

_EVERY = 10
"""One of this many ticks is kept by a run for its report."""

COMMAND = np.array([-7.0, -6.0])
"""With which the robot hops while the cost of a tick is measured [N]."""

PACKAGES = ("stepgap", "numpy", "numba", "mujoco")
"""Whose versions the result names."""


@dataclass(frozen=True)
class TickCost:
    """Processor time of one tick of hopping, on average [µs].

    Attributes:
        loop: All of it, as in a deployment.
        physics: `mj_step` alone.
        control: One call of the control tick.
    """

    loop: float
    physics: float
    control: float


class Sampler:
    """Counts what is running, by the first of `PARTS` that one of the running functions belongs to."""

    def __init__(self) -> None:
        self.counts: Counter[str] = Counter()
        self._names: dict[str, list[str]] = {}

    @contextmanager
    def running(self) -> Iterator[None]:
        """Looks every millisecond of processor time."""
        before = signal.signal(signal.SIGPROF, self._look)
        signal.setitimer(signal.ITIMER_PROF, _LOOK_EVERY, _LOOK_EVERY)
        try:
            yield
        finally:
            signal.setitimer(signal.ITIMER_PROF, 0)
            signal.signal(signal.SIGPROF, before)

    def _look(self, _number: int, frame: FrameType | None) -> None:
        seen = set[str]()
        while frame:
            seen.add(frame.f_code.co_filename)
            frame = frame.f_back
        self.counts[self._part(seen)] += 1

    def _part(self, files: set[str]) -> str:
        for part, places in PARTS:
            if any(place in file for file in files for place in places):
                return part
        return REST


class RecordedTwin(Twin):
    """A twin that remembers what MuJoCo was given at every tick."""

    def connect(self) -> None:
        """Puts the robot into its starting pose."""
        super().connect()
        self.record()

    def record(self) -> None:
        """Begins with the present motion."""
        self.start, self.given = copy(self._data), list[tuple[float, ...]]()

    @property
    def ticks(self) -> int:
        """Ticks since the recording began."""
        return round((self._data.time - self.start.time) / self.sensor_model.tick)

    def keep(self, _tick: Any) -> None:
        """The tick is over, and what it was given is still there."""
        force = self._force
        self.given.append((*self._ctrl, force[self._motor_1], force[self._motor_2], self._ground_position[2]))

    def bare_time(self) -> float:
        """Processor time of `mj_step` over the recorded ticks [s], which must move the robot as they did."""
        data = copy(self.start)
        ctrl, force, ground = data.ctrl, data.qfrc_applied, data.mocap_pos[0]
        first, second, model, steps = self._motor_1, self._motor_2, self._model, self._substeps
        begin = thread_time()
        for ctrl[0], ctrl[1], force[first], force[second], ground[2] in self.given:
            pass
        between = thread_time()
        for ctrl[0], ctrl[1], force[first], force[second], ground[2] in self.given:
            mujoco.mj_step(model, data, steps)
        spent = (thread_time() - between) - (between - begin)
        assert np.array_equal(data.qpos, self._data.qpos), "the recorded ticks move the robot as they did"
        return spent


def tick_cost(settings: Experiment) -> TickCost:
    """The cost of a tick of hopping on the settings' twin, with all that a run does in a tick."""
    control = HopperControl(settings.robot, settings.gains, settings.command)
    twin = RecordedTwin(settings.robot, settings.gap, np.random.default_rng(settings.seed))
    plain = RigPlant(twin, control, TickRecorder(_EVERY).on_tick)
    recorded = RigPlant(twin, control, twin.keep)
    costs = []
    for _ in range(TURNS):
        loop = _hopping_time(plain, twin)
        _hopping_time(recorded, twin)
        costs.append((loop, twin.bare_time() / twin.ticks))
    loop, physics = np.median(costs, axis=0) * 1e6
    return TickCost(float(loop), float(physics), _control_cost(control.control(twin), twin))


def _hopping_time(plant: RigPlant, twin: RecordedTwin) -> float:
    """Processor time of a tick of some hops [s]."""
    with plant:
        plant.start()
        twin.record()
        begin = thread_time()
        for _ in range(HOPS):
            plant.take_step(COMMAND)
        return (thread_time() - begin) / twin.ticks


def _control_cost(control: HopControl, twin: Twin, calls: int = 20_000) -> float:
    """Processor time of one call of the control tick from Python, the least of some rounds [µs]."""
    twin.connect()
    reading, order, spent = twin.read(), Order(Mode.STEP, 1.0, (-7.0, -6.0)), []
    for _ in range(5):
        begin = thread_time()
        for number in range(calls):
            control.tick(1e-3 * number, reading, order, (0.0, 0.0), HEALTHY)
        spent.append(thread_time() - begin)
    twin.close()
    return min(spent) / calls * 1e6


def bench_run(settings: Experiment, run: Callable[[], object]) -> dict[str, Any]:
    """Measures a run.

    Args:
        settings: Of the run.
        run: Runs it, report included.

    Returns:
        Processor time of the parts [s], of a tick [µs], ratios to `mj_step` alone, and the machine. Loading, which
        includes compilation on a machine's first run, is no part of the ratios.
    """
    sampler, begin = Sampler(), process_time()
    with sampler.running():
        run()
    total, looks = process_time() - begin, sum(sampler.counts.values())
    seconds = {part: total * count / looks for part, count in sampler.counts.items()}
    tick = tick_cost(settings)
    hopping = seconds.pop(HOPPING, 0.0)
    physics, control = (hopping * part / tick.loop for part in (tick.physics, tick.control))
    parts = {"physics": physics, "control tick": control, "rest of the twin": hopping - physics - control}
    return {
        "seconds": {**parts, **{part: seconds.get(part, 0.0) for part in ("planning", "learning", "files", "report")}}
        | {part: seconds.get(part, 0.0) for part in (LOADING, REST)},
        "total": total,
        "tick": asdict(tick),
        "hopping_to_physics": tick.loop / tick.physics,
        "run_to_physics": (total - seconds.get(LOADING, 0.0)) / physics,
        "machine": machine(PACKAGES),
    }


def describe_run(result: Mapping[str, Any]) -> str:
    """The result as a table."""
    total, tick = result["total"], result["tick"]
    lines = [f"{part:18} {seconds:7.2f} s  {seconds / total:6.1%}" for part, seconds in result["seconds"].items()]
    return "\n".join(
        [
            *lines,
            f"{'total':18} {total:7.2f} s",
            f"A tick of 1 ms takes {tick['loop']:.1f} µs: mj_step {tick['physics']:.1f} µs, the control tick "
            f"{tick['control']:.2f} µs.",
            f"Hopping takes {result['hopping_to_physics']:.2f} times the mj_step calls in it, "
            f"the whole run without loading {result['run_to_physics']:.2f} times.",
        ]
    )

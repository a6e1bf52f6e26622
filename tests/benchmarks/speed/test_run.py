"""The division of a run's CPU time: the parts add up, and the physics alone reproduces the motion."""

from time import process_time

import numpy as np
import pytest

from benchmarks.speed import run as bench
from benchmarks.speed.run import LOADING, PARTS, RecordedTwin, Sampler, bench_run, describe_run
from stepgap.experiment.settings import read_experiment
from stepgap.plants.rig_plant import RigPlant
from stepgap.robots.hopper.robot import Hopper, as_hopper


def hop(settings):
    """Some seconds of hopping."""
    hopper = as_hopper(settings.robot, "")
    twin = RecordedTwin(hopper.parameters, hopper.gap, np.random.default_rng(1))
    with RigPlant(twin, hopper.control()) as plant:
        plant.start()
        for _ in range(8):
            plant.take_step(np.array([-7.0, -6.0]))


def test_the_parts_add_up_and_hopping_is_hopping(monkeypatch):
    monkeypatch.setattr(bench, "TURNS", 2)
    monkeypatch.setattr(bench, "HOPS", 4)
    settings = read_experiment(None, [])
    hop(settings)  # compiled code is loaded
    result = bench_run(settings, lambda: hop(settings))
    seconds = result["seconds"]
    assert sum(seconds.values()) == pytest.approx(result["total"])
    hopping = sum(seconds[part] for part in ("physics", "control tick", "rest of the twin"))
    assert hopping > 0.7 * result["total"]
    assert seconds["physics"] == pytest.approx(hopping / result["hopping_to_physics"])
    assert result["hopping_to_physics"] > 0.5
    assert "times as long as its mj_step calls" in describe_run(result)


def test_bare_physics_moves_the_robot_as_the_recorded_ticks_did():
    hopper = Hopper()
    twin = RecordedTwin(hopper.parameters, hopper.gap, np.random.default_rng(1))
    with RigPlant(twin, hopper.control(), twin.keep, 1) as plant:
        plant.start()
        twin.record()
        plant.take_step(np.array([-7.0, -6.0]))
        assert len(twin.given) == twin.ticks > 500
        assert twin.bare_time() > 0
        twin.given[100] = (5.0, *twin.given[100][1:])
        with pytest.raises(AssertionError, match="must reproduce the motion"):
            twin.bare_time()


def test_samples_are_counted_by_the_files_of_the_running_functions():
    sampler, begin = Sampler(), process_time()
    with sampler.running():
        while sampler.seconds.get("rest", 0.0) < 0.03 and process_time() - begin < 30:
            pass  # a busy machine takes fewer samples
    assert set(sampler.seconds) == {"rest"}
    assert 0.03 <= sampler.seconds["rest"] < process_time() - begin
    assert PARTS[0][0] == LOADING

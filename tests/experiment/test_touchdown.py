"""Heights above the ground and a new command at touchdown: plants, deployments and the real tick."""

from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest

from stepgap.base.random_streams import random_stream
from stepgap.control.reference import Reference
from stepgap.experiment.deployment import deploy
from stepgap.experiment.noise_floor import measure_noise_floor
from stepgap.learning.learner import Learner
from stepgap.learning.observations import observe
from stepgap.learning.settings import LearningSettings
from stepgap.learning.steps import LoggedStep, Steps
from stepgap.plants.plant import Touchdown
from stepgap.records.steps_csv import StepWriter, read_step_log
from stepgap.robots.ground import UnevenGround
from stepgap.robots.hopper.robot import Hopper
from stepgap.robots.nominal_maps.weighted_map import with_space
from stepgap.step import ContextQuantity, Quantity, StepRecord, StepSpace, StepStatus

STAIRS = Hopper(ground=UnevenGround(stair_height=0.04, stair_length=0.2))
FLAT = Hopper(ground=UnevenGround(measured_heights=True))
COMMAND, OTHER = np.array([-4.0, -3.0]), np.array([-6.0, 2.0])


def plant_of(robot, seed=0):
    return robot.simulations()["twin"](random_stream(seed)).plant(random_stream(seed, 0))


def test_a_state_above_its_context():
    space = StepSpace(
        (Quantity("speed", "m/s", 0, 1), Quantity("height", "m", 0, 1, above="ground")),
        (Quantity("force", "N", 0, 1),),
        (ContextQuantity("yaw", "rad"), ContextQuantity("ground", "m")),
    )
    np.testing.assert_array_equal(space.above(np.array([0.5, 0.6]), (9.0, 0.25)), [0.5, 0.6 - 0.25])
    np.testing.assert_array_equal(space.above(np.array([0.5, 0.6]), ()), [0.5, 0.6])
    assert space.is_above_context
    with pytest.raises(ValueError, match=r"above = .floor., but it must be the name of a context quantity"):
        replace(space, state=(Quantity("height", "m", 0, 1, above="floor"),))


def test_the_command_of_the_touchdown_acts():
    """The step is the same, tick by tick, as one that had this command from its start."""
    records = []
    for first in (COMMAND, OTHER):
        with plant_of(STAIRS) as plant:
            plant.start()
            records.append(plant.take_replanned_step(first, lambda found: OTHER))
    np.testing.assert_equal(vars(records[0]), vars(records[1]))
    np.testing.assert_array_equal(records[0].command, OTHER)


def test_what_is_found_is_what_is_recorded():
    """Also the ground, as the twin knows it, within its bias."""
    found: list[Touchdown] = []

    def plan(touchdown):
        found.append(touchdown)
        return COMMAND

    with plant_of(STAIRS) as plant:
        plant.start()
        before, grounds = None, []
        for number in range(1, 9):
            record = plant.take_replanned_step(COMMAND, plan)
            assert len(found) == number
            np.testing.assert_array_equal(found[-1].state, record.state)
            assert found[-1].context["ground"] == record.context["ground"]
            grounds.append(record.context["ground"])
            if before is not None:  # the same apex, above another ground
                risen = record.context["ground"] - before.context["ground"]
                np.testing.assert_allclose(record.state - before.next_state, [0, -risen], atol=1e-12)
            np.testing.assert_allclose(record.true_next_state, record.next_state, atol=5e-3)
            before = record
    assert np.ptp(grounds) > 0.02


def test_a_wrong_command_of_a_touchdown_ends_no_step():
    with plant_of(STAIRS) as plant:
        plant.start()
        record = plant.take_replanned_step(COMMAND, lambda found: np.array([1e9, -1e9]))
        np.testing.assert_array_equal(
            record.requested, plant.space.command_centre + [1, -1] * plant.space.command_scale
        )


def hops_of(robot, nominal, replanned=True):
    reference = Reference(("speed", "height"), np.tile([0.2, 0.58], (12, 1)))
    learner = Learner.start(nominal, Steps(nominal.space), LearningSettings(residual="none"), 0)
    plant = plant_of(robot)
    if not replanned:
        replan = plant.take_replanned_step
        plant.take_replanned_step = lambda command, at_touchdown: replan(command, lambda _: command)
    with closing(deploy(learner, plant, reference.of(nominal.space), 0)) as steps:
        return [each for each in steps if each.planned]


def test_planned_again_at_touchdown_stairs_are_hopped_as_flat_ground_is():
    nominal = with_space(Hopper().nominal_maps()["equations"](), STAIRS.space)
    error = {
        name: np.array([each.record.next_state - each.target for each in hops_of(robot, nominal, replanned)])
        for name, robot, replanned in (("flat", FLAT, True), ("stairs", STAIRS, True), ("late", STAIRS, False))
    }
    size = {name: np.std(each[3:, 1]) for name, each in error.items()}  # the map's constant error is not learned here
    assert len(error["stairs"]) == 12
    assert size["flat"] < size["stairs"] < 0.01
    assert size["late"] > 2 * size["stairs"]


def test_a_step_that_was_not_planned_again_is_predicted_from_the_ground_that_it_found():
    nominal = with_space(Hopper().nominal_maps()["equations"](), STAIRS.space)
    for each in hops_of(STAIRS, nominal, replanned=False):
        predicted = nominal.evaluate(each.record.state, each.record.command).next_state
        np.testing.assert_allclose(each.predicted, predicted)


@pytest.mark.parametrize("command", [[np.nan, -3.0], [-4.0, np.inf], [1.0]])
def test_a_command_that_is_not_finite_leaves_the_first_one(command):
    with plant_of(STAIRS) as plant:
        plant.start()
        record = plant.take_replanned_step(COMMAND, lambda found: np.array(command))
        assert record.status == StepStatus.OK
        np.testing.assert_array_equal(record.requested, COMMAND)


def test_an_exploratory_step_keeps_its_command():
    """Its target is what its map predicts of it, from the ground that it found."""
    nominal = STAIRS.apex_map()
    learner = Learner.start(nominal, Steps(nominal.space), LearningSettings(online=True), 0)
    reference = Reference(("speed", "height"), np.tile([0.2, 0.58], (2, 1))).of(nominal.space)
    with closing(deploy(learner, plant_of(STAIRS), reference, 0, exploration=4)) as steps:
        explored = [each for each in steps if each.step < 1 and each.planned]
    assert len(explored) >= 3
    for each in explored:
        np.testing.assert_array_equal(each.target, each.predicted)


def test_known_steps_of_flat_ground_have_heights_above_it(tmp_path):
    """A file of a run without measured ground has no column of it."""
    plain, uneven = Hopper().space, STAIRS.space
    record = StepRecord(np.array([0.1, 0.56]), COMMAND, COMMAND, np.array([0.2, 0.57]), StepStatus.OK, {"yaw": 0.1})
    path = tmp_path / "steps.csv"
    with closing(StepWriter(path, plain)) as writer:
        writer.append(LoggedStep(0, 1, np.array([0.2, 0.57]), record.next_state, np.zeros(2), record))
    known = read_step_log(path, uneven)
    observed = observe(known, STAIRS.apex_map())
    np.testing.assert_array_equal(known.next_state, [record.next_state])
    assert observed.context_inputs == 2
    assert observed.history is not None
    assert not observed.history[:, -2:].any()


def test_no_noise_floor_is_measured_where_the_ground_belongs_to_the_place():
    nominal, rng = STAIRS.apex_map(), np.random.default_rng(0)
    simulation = STAIRS.simulations()["twin"](random_stream(0))
    reference = Reference(("speed", "height"), np.tile([0.2, 0.58], (12, 1)))
    found = measure_noise_floor(simulation.repeatable_plant, nominal, reference, rng, lambda done, of: None, 1)
    assert np.isnan(found.any_phase).all()

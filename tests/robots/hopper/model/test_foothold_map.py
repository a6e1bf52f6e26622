"""The stride from foothold to foothold: its derivatives, and the twin without any difference from the model."""

from contextlib import closing

import numpy as np

from stepgap.base.random_streams import random_stream
from stepgap.control.reference import Reference
from stepgap.experiment.deployment import deploy
from stepgap.learning.learner import Learner
from stepgap.learning.settings import LearningSettings
from stepgap.learning.steps import Steps
from stepgap.robots.ground import UnevenGround
from stepgap.robots.hopper.model.foothold_map import FootholdMap
from stepgap.robots.hopper.robot import Hopper
from stepgap.robots.hopper.twin.reality_gap import RealityGap
from stepgap.step import difference_jacobian

HOPPER = Hopper(ground=UnevenGround(footholds=True))


def test_the_derivatives_are_those_of_the_map():
    nominal = HOPPER.apex_map()
    assert isinstance(nominal, FootholdMap)
    rng = np.random.default_rng(0)
    state, command = rng.uniform([0.05, 0.54, 0], [0.4, 0.62, 0.5], (5, 3)), rng.uniform(-5, 5, (5, 2))
    found = nominal.jacobian(state, command)
    of_apexes = nominal.apexes.jacobian(state[:, :2], command)
    np.testing.assert_array_equal(found[:, :2][..., [0, 1, 3, 4]], of_apexes)
    assert not found[..., 2].any()
    np.testing.assert_allclose(found, difference_jacobian(nominal, state, command), atol=1e-5)


def test_a_step_that_fails_has_no_stride():
    found = HOPPER.apex_map().evaluate([[0.2, 0.1, 0.0]], [[0.0, 0.0]])
    assert np.isnan(found.next_state).all()
    assert found.status[0]


def test_a_robot_as_modelled_steps_where_it_should():
    """Footholds are those wanted, without learning; what is off is made good, and does not add up."""
    robot = Hopper(gap=RealityGap.none(), ground=HOPPER.ground)
    strides = np.array([0.1, 0.18, 0.25, 0.2, 0.3, 0.22, 0.15, 0.25, 0.28, 0.2])
    reference = Reference(("height", "stride"), np.column_stack([np.full(len(strides), 0.58), strides]))
    plant = robot.simulations()["twin"](random_stream(0)).plant(random_stream(0, 0))
    learner = Learner.start(robot.apex_map(), Steps(robot.space), LearningSettings(residual="none", drift=False), 0)
    with closing(deploy(learner, plant, reference.of(robot.space), 0)) as steps:
        log = Steps(robot.space, steps).tracking()
    footholds = log.context[:, robot.space.context_names.index("foothold")]
    wanted = np.cumsum(strides)[:-1]
    assert np.abs(footholds[1:] - wanted)[2:].max() < 0.025
    np.testing.assert_allclose(log.target[:, 2], strides + np.append(0.0, wanted) - footholds, atol=1e-12)
    np.testing.assert_allclose(log.next_state[2:-1, 2], np.diff(footholds)[2:], atol=0.01)
    assert not log.state[:, 2].any()

"""The states of a deployment on the twin, tick by tick, without clock or second process."""

from math import inf

import numpy as np
import pytest

from stepgap.hardware.realtime.board import Board, Request
from stepgap.hardware.realtime.loop import ControlLoop, LoopSettings
from stepgap.plants.ticks.rig_state import RigState
from stepgap.robots.hopper import CommandBounds, Gains, RobotParameters
from stepgap.robots.hopper.tick.hop_control import HopControl
from stepgap.robots.hopper.tick.limits import SafetyLimits
from stepgap.robots.hopper.twin.reality_gap import RealityGap
from stepgap.robots.hopper.twin.twin import Twin
from stepgap.step import StepStatus
from tests.rig_ticks import LOG_UNITS

ROBOT, GAINS, BOUNDS = RobotParameters(), Gains(), CommandBounds()
LIMITS = SafetyLimits(torque=38.0, torque_step=20.0, joint_speed=80.0, fold_angle=2.6, lowest_hip=0.1, highest_hip=0.9)
COLUMN = {name: index for index, name in enumerate(LOG_UNITS)}
COMMAND = (-4.0, -3.0)


class Deployment:
    """A loop on the twin, and its log."""

    def __init__(self, alive=lambda: True, hold=1.0, limits=LIMITS, release_time=inf):
        self.rows, self.board = [], Board.create(2, 2, 1)
        self.twin = Twin(ROBOT, RealityGap(), np.random.default_rng(0), hold=hold)
        self.twin.connect()
        control = HopControl(self.twin.sensor_model, ROBOT, GAINS, limits)
        settings = LoopSettings(release_time=release_time)
        self.loop = ControlLoop(self.twin, control, BOUNDS.space(), self.board, self.rows.append, settings, alive)

    def __enter__(self):
        return self

    def __exit__(self, *exc_info):
        self.twin.close()
        self.board.close()
        self.board.unlink()

    def run(self, until, most=20_000, late=0.0):
        """Runs ticks until a condition holds or the robot is off; returns whether it is still running."""
        for _ in range(most):
            if not self.loop.tick(late):
                return False
            if until():
                return True
        pytest.fail(f"the condition does not hold; it is in {self.loop.state.name}: {self.board.message}")

    def hop(self, number):
        """Posts the command of a hop and runs ticks until it has ended."""
        if number:
            self.board.post_command(number, COMMAND)
        self.run(lambda: self.board.finished(number) is not None)
        return self.ended(number)

    def ended(self, number):
        """Result of a hop."""
        found = self.board.finished(number)
        assert found is not None
        return found

    def hopping(self):
        """Whether the first hop has ended."""
        self.board.request = Request.START
        return self.hop(0)

    def column(self, name):
        return np.array(self.rows)[:, COLUMN[name]]

    @property
    def torques(self):
        return np.stack([self.column("applied_1"), self.column("applied_2")], axis=1)


def test_a_limp_robot_waits_for_a_request():
    with Deployment(hold=10.0) as deployment:
        deployment.run(lambda: len(deployment.rows) == 1000)
        assert deployment.board.state == RigState.READY
        assert not deployment.torques.any()
        assert np.abs(deployment.column("asked_1")).max() > 0, "the torques that it would apply are logged"


def test_it_stands_gently_hops_as_commanded_and_lands():
    with Deployment() as deployment:
        assert deployment.hopping().status == StepStatus.OK
        for number in (1, 2, 3):
            hop = deployment.hop(number)
            assert hop.status == StepStatus.OK
            np.testing.assert_allclose(hop.result.applied, COMMAND, atol=0.5)
            assert 0.5 < hop.result.state[1] < 0.65
        deployment.board.request = Request.STOP
        assert not deployment.run(lambda: False)
        states = deployment.column("state")
        assert [RigState(state).name for state in dict.fromkeys(states)] == [
            "CALIBRATE", "READY", "STAND", "STEP", "STOP", "OFF",
        ]  # fmt: skip
        assert np.abs(deployment.torques).max() <= LIMITS.torque
        assert np.abs(np.diff(deployment.torques, axis=0)).max() <= LIMITS.torque_step * (1 + 1e-12)
        standing = deployment.torques[states == RigState.STAND]
        ramp = 40.0 * np.linspace(0, 1, len(standing))
        assert (np.abs(standing).max(axis=1) <= ramp + 1e-9).all()
        assert not deployment.torques[states == RigState.OFF].any()
        forces = deployment.column("contact_force")
        assert forces[states == RigState.STOP].max() < forces[states == RigState.STEP].max(), "it lands softly"
        assert deployment.twin.true_state().hip[1] < 0.3, "it has sunk down"


def test_a_hop_without_a_command_has_none_and_two_in_a_row_land_the_robot():
    with Deployment() as deployment:
        deployment.hopping()
        assert deployment.hop(1).status == StepStatus.OK
        deployment.run(lambda: deployment.board.finished(2) is not None)
        missed = deployment.ended(2)
        assert missed.status == StepStatus.OK
        np.testing.assert_allclose(missed.result.applied, 0, atol=0.5)
        assert not deployment.run(lambda: False)
        assert deployment.loop.state == RigState.OFF
        assert "no command" in deployment.board.message


def test_a_command_after_mid_stance_counts_as_not_applied():
    with Deployment() as deployment:
        deployment.hopping()
        pushing = 3
        deployment.run(lambda: deployment.rows[-1][COLUMN["phase"]] == pushing)
        deployment.board.post_command(1, COMMAND)
        deployment.run(lambda: deployment.board.finished(1) is not None)
        hop = deployment.ended(1)
        np.testing.assert_allclose(hop.result.applied, 0, atol=0.5)


def test_the_robot_lands_if_the_learning_process_died():
    alive = [True]
    with Deployment(alive=lambda: alive[0]) as deployment:
        deployment.hopping()
        alive[0] = False
        deployment.board.post_command(1, COMMAND)
        assert not deployment.run(lambda: False)
        assert deployment.loop.state == RigState.OFF


@pytest.mark.parametrize("command", [(np.nan, 0.0), (0.0, np.inf)])
def test_a_command_that_is_not_finite_is_a_fault_without_torque(command):
    with Deployment() as deployment:
        deployment.hopping()
        deployment.board.post_command(1, command)
        assert not deployment.run(lambda: False)
        assert deployment.loop.state == RigState.FAULT
        assert "must be finite" in deployment.board.message
        hop = deployment.ended(1)
        assert hop.status == StepStatus.STOPPED


def test_a_command_beyond_its_bounds_acts_at_the_bound():
    with Deployment() as deployment:
        deployment.hopping()
        deployment.board.post_command(1, (1e9, -1e9))
        deployment.run(lambda: deployment.board.finished(1) is not None)
        hop = deployment.ended(1)
        assert hop.result.applied[0] <= BOUNDS.fx_upper + 1
        assert hop.result.applied[1] >= BOUNDS.fy_lower - 1


def test_the_software_stop_takes_torque_off_at_the_next_tick_for_good():
    with Deployment() as deployment:
        deployment.hopping()
        deployment.board.stop_at_once()
        assert not deployment.run(lambda: False)
        assert deployment.loop.state == RigState.FAULT
        assert not deployment.torques[-1].any()
        assert "emergency stop" in deployment.board.message
        hop = deployment.ended(1)
        assert hop.status == StepStatus.STOPPED


def test_a_stalled_loop_brakes_and_then_is_off():
    with Deployment() as deployment:
        deployment.hopping()
        before = len(deployment.rows)
        assert deployment.loop.tick(0.0035)  # three ticks missed, two are allowed
        assert not deployment.run(lambda: False)
        assert len(deployment.rows) - before == LIMITS.brake_ticks + 1
        assert deployment.loop.state == RigState.FAULT
        assert "late" in deployment.board.message
        assert not deployment.torques[-1].any()
        assert deployment.board.missed_ticks == 3


def test_a_limp_robot_does_not_brake():
    with Deployment(hold=10.0) as deployment:
        deployment.run(lambda: deployment.loop.state == RigState.READY)
        assert not deployment.loop.tick(0.0035)
        assert deployment.loop.state == RigState.FAULT
        assert not deployment.torques.any()


def test_a_rig_fault_is_reported_with_its_message():
    with Deployment() as deployment:
        deployment.hopping()
        deployment.twin._trip("a drive has tripped")  # as the twin does when a motor runs away
        assert not deployment.loop.tick()
        assert deployment.board.message == "a drive has tripped"
        assert deployment.board.state == RigState.FAULT


def test_stopping_before_the_first_hop_never_gives_torque_on_a_limp_robot():
    with Deployment() as deployment:
        deployment.board.request = Request.STOP
        assert not deployment.run(lambda: False)
        assert not deployment.torques.any()

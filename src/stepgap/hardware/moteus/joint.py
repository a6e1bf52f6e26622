"""Commands and states of a joint, as in many drive families, and their conversion for moteus."""

from dataclasses import dataclass
from math import isfinite, nan, tau
from typing import NamedTuple


class JointCommand(NamedTuple):
    """Command of a joint, whose drive gives the torque kp (q − q_now) + kd (dq − dq_now) + tau.

    Attributes:
        q: Angle [rad].
        dq: Its rate [rad/s].
        kp: Stiffness [N·m/rad].
        kd: Damping [N·m·s/rad].
        tau: Feedforward torque [N·m].
    """

    q: float
    dq: float
    kp: float
    kd: float
    tau: float


class JointState(NamedTuple):
    """State of a joint, as measured by its drive.

    Attributes:
        q: Angle [rad].
        dq: Its rate [rad/s].
        tau: Torque [N·m].
    """

    q: float
    dq: float
    tau: float


@dataclass(frozen=True)
class Scale:
    """Units of a moteus controller: turns and N·m of its output, and gains as fractions of its configured ones.

    Attributes:
        gear: Turns of the controller's output per turn of the joint.
        sign: 1 if output and joint turn in the same direction, else −1.
        zero: Position of the output at angle zero [turns].
        servo_kp: The controller's `servo.pid_position.kp` [N·m/turn].
        servo_kd: The controller's `servo.pid_position.kd` [N·m·s/turn].
    """

    gear: float
    sign: int
    zero: float
    servo_kp: float
    servo_kd: float

    def position_command(self, command: JointCommand) -> dict[str, float]:
        """Converts a command to arguments of `moteus.Controller.make_position`; without stiffness the position is NaN.

        Raises:
            ValueError: A number is not finite, a gain is negative, or the damping is larger than moteus supports: it
                limits the scale of kd to that of kp.
        """
        if not all(map(isfinite, command)):
            raise ValueError(f"a joint command must be finite, not {command}")
        if command.kp < 0 or command.kd < 0:
            raise ValueError(f"gains must not be negative: {command}")
        per_turn = tau / self.gear**2
        kp_scale, kd_scale = command.kp * per_turn / self.servo_kp, command.kd * per_turn / self.servo_kd
        if kd_scale > kp_scale:
            raise ValueError(f"kd = {command.kd} must be at most {self.servo_kd / self.servo_kp * command.kp:g} here")
        turns = self.sign * self.gear / tau
        return {
            "position": self.zero + turns * command.q if command.kp else nan,
            "velocity": turns * command.dq if command.kp else 0.0,
            "feedforward_torque": self.sign * command.tau / self.gear,
            "kp_scale": kp_scale,
            "kd_scale": kd_scale,
            "ilimit_scale": 0.0,
        }

    def joint_state(self, position: float, velocity: float, torque: float) -> JointState:
        """Converts the registers of the controller [turns, turns/s, N·m] to the state of the joint."""
        angle = self.sign * tau / self.gear
        return JointState(angle * (position - self.zero), angle * velocity, self.sign * self.gear * torque)

"""Commands and states of a joint, as many drive families have them, and what moteus makes of them."""

from dataclasses import dataclass
from math import isfinite, nan, tau
from typing import NamedTuple


class JointCommand(NamedTuple):
    """The drive gives the torque kp (q − q_now) + kd (dq − dq_now) + tau.

    Attributes:
        q: Angle [rad].
        dq: Its rate [rad/s].
        kp: Stiffness [N·m/rad].
        kd: Damping [N·m·s/rad].
        tau: Torque added [N·m].
    """

    q: float
    dq: float
    kp: float
    kd: float
    tau: float


class JointState(NamedTuple):
    """What a drive says of its joint.

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
    """How a moteus controller counts: in turns and N·m of its output, gains as parts of those it is configured to.

    Attributes:
        gear: Turns of the controller's output per turn of the joint.
        sign: 1 where the output turns as the joint does, else −1.
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
        """The arguments of `moteus.Controller.make_position`; without stiffness the position is "where you are".

        Raises:
            ValueError: A number is not finite, a gain negative, or there is more damping than moteus would give: it
                cuts the scale of kd to that of kp.
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
        """The joint by the registers of its controller [turns, turns/s, N·m]."""
        angle = self.sign * tau / self.gear
        return JointState(angle * (position - self.zero), angle * velocity, self.sign * self.gear * torque)

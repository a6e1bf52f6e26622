"""The controller of Gymnasium's hopper for one tick: inverse dynamics in stance, joint control in flight.

In stance three things are chosen: the vertical force of the ground, the point where it acts, and the acceleration of
the torso's pitch. Together with the condition that the foot rests, they determine the three torques (inverse dynamics
with a constraint; Khatib 1987). The hopper sinks into a crouch as on a spring
with a damper, then pushes off with a constant acceleration until its knee is nearly straight. In flight its joints go
to a landing posture, with the foot parallel to the ground and further ahead at higher speed (Raibert 1986).

The gains were found by a random search: with random commands, few falls in the model and with the default gap, and next
states that a quadratic polynomial of state and command predicts well.
"""

import mujoco
import numpy as np

PITCH, THIGH, KNEE = -1.05, -0.711, -0.803
"""Posture at landing [rad]; the thigh cannot swing forward of the torso, so the torso leans back."""
LAST_KNEE = -0.676
"""Knee angle at which the push ends [rad]."""
JOINT_GAIN, JOINT_DAMPING = 1210.0, 82.4
"""Flight: N·m/rad and N·m·s/rad."""
SPRING, DAMPING, DEPTH = 10.5, 1.03, 0.153
"""Crouch: frequency [rad/s], damping ratio, and depth of the centre of mass [m]."""
FOOT_SHIFT, PLACEMENT, CORRECTION = 0.174, 0.148, -0.0291
"""Per error of speed the shift of the ground force [s]; landing angle per speed and per its error [rad·s/m]."""
PITCH_GAIN, PITCH_DAMPING = 413.0, 37.0
"""Torso: 1/s² and 1/s."""
SPIN_TO_PITCH, SPIN_TO_SHIFT = -3.57, 0.0869
"""Acceleration of pitch [rad/s² per N·m·s], and shift of the force [1/N], with the angular momentum of the robot."""
LEVEL_GAIN, LEVEL_DAMPING = 465.0, 55.3
"""Foot parallel to the ground: 1/s² and 1/s."""
SETTLED, BRAKING, OFFSET, FADING = 0.213, 0.12, 0.0113, 0.31
"""The push begins at this speed of sinking [m/s], but at least this time after landing [s]; constant shift of the
force [m]; range of the knee's angle in which the push fades [rad]."""
GRAVITY = 9.81
FOOT, HALF_SOLE, SOLE = 4, 0.15, 0.06
"""Body of the foot, half the length on which the force may act, and radius of the foot [m]."""


def landing_posture(model, pitch):
    """Positions with the foot flat on the ground; shape (6,)."""
    data = mujoco.MjData(model)
    data.qpos[2:] = pitch, THIGH, KNEE, pitch - THIGH - KNEE
    mujoco.mj_kinematics(model, data)
    data.qpos[1] -= data.geom("foot_geom").xpos[2] - SOLE
    return data.qpos


def mass_centre(model, data):
    """Position and velocity of the centre of mass; each of shape (3,) [m, m/s]."""
    mujoco.mj_fwdPosition(model, data)
    mujoco.mj_fwdVelocity(model, data)
    mujoco.mj_subtreeVel(model, data)
    return data.subtree_com[1], data.subtree_linvel[1]


class HopperLaw:
    """The controller with its memory: whether it stands, and whether it pushes off.

    Args:
        model: Model by which the torques are computed; the plant differs from it.
    """

    def __init__(self, model):
        self._model, self._data = model, mujoco.MjData(model)
        self._data.qpos[:] = landing_posture(model, PITCH)
        self._landing_height = mass_centre(model, self._data)[0][2]
        self._mass = model.body_subtreemass[1]
        self._standing, self._pushing, self._landed = False, False, 0.0

    def __call__(self, model, data, command):
        """Writes `data.ctrl`; the command is the speed [m/s] that the hopper aims at, and its push [m/s²]."""
        own = self._data
        own.qpos[:], own.qvel[:] = data.qpos, data.qvel
        centre, velocity = mass_centre(self._model, own)
        self._change_phase(velocity[2], data.time)
        error = velocity[0] - command[0]
        torques = self._stance(centre, velocity, error, command[1]) if self._standing else self._flight(velocity, error)
        data.ctrl[:] = np.clip(torques / model.actuator_gear[:, 0], -1, 1)

    def _change_phase(self, rate, time):
        knee = self._data.qpos[4]
        if self._data.ncon and rate < 0 and not self._standing:
            self._standing, self._landed = True, time
        if self._pushing and (self._data.ncon == 0 or knee > LAST_KNEE):
            self._standing = self._pushing = False
        if self._standing and rate > -SETTLED and time > self._landed + BRAKING:
            self._pushing = True

    def _flight(self, velocity, error):
        """Torques that accelerate the joints towards the landing posture while nothing touches the ground."""
        q, rates = self._data.qpos, self._data.qvel
        foot = q[2] - q[3] - q[4]
        foot_rate = rates[2] - rates[3] - rates[4]
        posture = np.array([THIGH + PLACEMENT * velocity[0] + CORRECTION * error, KNEE, foot])
        wanted = JOINT_GAIN * (posture - q[3:]) - JOINT_DAMPING * (rates[3:] - [0.0, 0.0, foot_rate])
        mass, bias = self._dynamics()
        root = np.linalg.solve(mass[:3, :3], -bias[:3] - mass[:3, 3:] @ wanted)
        return mass[3:, :3] @ root + mass[3:, 3:] @ wanted + bias[3:]

    def _stance(self, centre, velocity, error, push):
        """Torques with which the foot rests, the ground pushes as wanted, and the torso turns as wanted."""
        q, rates = self._data.qpos, self._data.qvel
        spin = self._data.subtree_angmom[1][1]
        sole = self._data.geom("foot_geom").xpos - [0.0, 0.0, SOLE]
        force = self._mass * (GRAVITY + self._vertical(centre[2], velocity[2], push))
        shift = centre[0] - sole[0] + OFFSET + FOOT_SHIFT * error + SPIN_TO_SHIFT * spin
        shift = np.clip(shift, -HALF_SOLE, HALF_SOLE)
        turn = PITCH_GAIN * (PITCH - q[2]) - PITCH_DAMPING * rates[2] - SPIN_TO_PITCH * spin
        jacobian, drift = self._foot_motion(sole)
        level = q[2] - q[3] - q[4] - q[5]
        rest = -drift - [0.0, 0.0, LEVEL_GAIN * level + LEVEL_DAMPING * (jacobian[2] @ rates)]
        mass, bias = self._dynamics()
        # Unknown are 6 accelerations, 3 torques, and of the ground two forces and a moment.
        equations, right = np.zeros((12, 12)), np.zeros(12)
        equations[:6, :6], equations[3:6, 6:9], equations[:6, 9:] = mass, -np.eye(3), -jacobian.T
        equations[6:9, :6], equations[9, 10], equations[10, 11], equations[11, 2] = jacobian, 1, 1, 1
        right[:6], right[6:9], right[9:] = -bias, rest, (force, -shift * force, turn)
        return np.linalg.solve(equations, right)[6:9]

    def _vertical(self, height, rate, push):
        """Acceleration of the centre of mass [m/s²]: the push, which ends with the stretched knee, or the crouch."""
        if self._pushing:
            share = np.clip((LAST_KNEE - self._data.qpos[4]) / FADING, 0.05, 1.0)
            return share * (push + GRAVITY) - GRAVITY
        sunk = self._landing_height - DEPTH - height
        return max(SPRING**2 * sunk - 2 * DAMPING * SPRING * rate, 2.0 - GRAVITY)

    def _dynamics(self):
        """Mass matrix, and forces of gravity, rotation and damping."""
        mass = np.zeros((6, 6))
        mujoco.mj_fullM(self._model, self._data, mass)
        return mass, self._data.qfrc_bias - self._data.qfrc_passive

    def _foot_motion(self, point):
        """Jacobian of a point of the foot and of its angle, shape (3, 6), and their accelerations with qacc = 0."""
        rows, parts = ([0, 0, 1], [0, 2, 1]), []
        for derivative in (mujoco.mj_jac, mujoco.mj_jacDot):
            found = np.zeros((2, 3, 6))
            derivative(self._model, self._data, found[0], found[1], point, FOOT)
            parts.append(found[rows])
        return parts[0], parts[1] @ self._data.qvel

"""The twin's MuJoCo model: a boom, a four-bar leg, and a ground and a riser that can be moved under the foot.

MuJoCo's x points forward at yaw 0, y to the boom's pivot side, z up. On the arc the pivot stands over the
origin; in the plane the hip starts over it. Angles of the leg turn forward, about −y.
"""

# pyright: reportAttributeAccessIssue=false
# (MuJoCo ships no types for its compiled part.)

from copy import copy
from math import cos, exp, inf, isinf, pi, sin, sqrt, tan
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from stepgap.base.ranges import require
from stepgap.robots.ground import FLAT_GROUND, UnevenGround
from stepgap.robots.hopper.parameters import RobotParameters
from stepgap.robots.hopper.twin.drives import memory_size
from stepgap.robots.hopper.twin.reality_gap import RealityGap
from stepgap.robots.hopper.twin.treads import LOWEST_RISER
from stepgap.robots.scene import GroundPieces

FOOT_RADIUS = 1e-5
"""Radius of the colliding foot point [m]; the ground is lower by this radius, so contact starts at the foot's end."""

STICKING = 1e4
"""Coefficient that stands for infinite friction; the friction force that a hop needs is far smaller."""

HARD = (0.9999, 0.9999, 0.001, 0.5, 2.0)  # Stiffest impedance that MuJoCo allows

RECOVERY_RATE = 2000.0
"""Rate at which rigid ground removes a penetration [1/s]. At a higher rate it would throw the light foot up; at a lower
rate the foot would still be in the ground at take-off, and stick to it."""

RIGID_SHARE = 2.0
"""Mass coupled to the foot on rigid ground, in foot masses; large enough that the load presses the foot down more than
the integration error of a step lifts it."""

SLIP_RATE = 2000.0
"""Rate at which friction, where it is large enough, stops a sliding foot [1/s]: exponentially, whatever the step.
MuJoCo's convex friction adds a normal force of friction coefficient × this × slip speed × the mass coupled to the foot,
so neither may be large."""

HARMONICS = (3, 5, 8, 13, 21)
"""Waves of the rough ground per turn of the boom; the shortest is about two hops long."""

FORWARD = (1, 0, 0)
UP = (0, 0, 1)
LEG_AXIS = (0, -1, 0)
PITCH_AXIS = (-1, 0, 0)


class GroundProfile:
    """Height of the ground around the circle: a tilted floor plus a smooth random profile, and treads upon it.

    Args:
        gap: Gap with the slope and the roughness.
        boom_length: Radius of the circle [m].
        rng: Draws phases and treads; the profile is fixed from then on.
        uneven: What else is uneven.

    Attributes:
        waves: Waves per turn, phase [rad] and amplitude [m] of each wave; shape (w, 3), w = 0 for flat ground.
        treads: What else is uneven; None if nothing is.
    """

    def __init__(
        self, gap: RealityGap, boom_length: float, rng: np.random.Generator, uneven: UnevenGround = FLAT_GROUND
    ):
        amplitude = gap.ground_roughness * sqrt(2 / len(HARMONICS))
        phases = rng.uniform(0, 2 * pi, len(HARMONICS))
        waves = [(k, float(phase), amplitude) for k, phase in zip(HARMONICS, phases, strict=True) if amplitude > 0]
        slope = boom_length * tan(gap.ground_slope)
        self.waves = np.array([(1, 0.0, slope)] * (slope != 0) + waves, float).reshape(-1, 3)
        self.treads = None if uneven.is_flat else uneven.treads(2 * pi * boom_length, rng)
        self._boom_length = boom_length

    @property
    def has_risers(self) -> bool:
        """Whether the height jumps from a tread to the next."""
        if self.treads is None:
            return False
        ends = self.treads.ends(2 * pi * self._boom_length)
        ending = self.treads.height + self.treads.slope * (ends - self.treads.start)
        return bool((np.abs(np.roll(self.treads.height, -1) - ending) > LOWEST_RISER).any())

    def pieces(self, floor_yaw: float) -> GroundPieces | None:
        """The treads along the circle of a robot that starts at a yaw of the floor [rad], without the waves."""
        if self.treads is None:
            return None
        begin, height, slope, stiffness, friction = self.treads
        end = self.treads.ends(2 * pi * self._boom_length)
        start = self._boom_length * floor_yaw
        return GroundPieces(
            start=begin - start,
            end=end - start,
            start_height=height,
            end_height=height + slope * (end - begin),
            changed=(stiffness != 1) | (friction != 1),
        )

    @property
    def steepness(self) -> float:
        """Steepest rise of the ground, over length; at most that of all waves and the steepest tread together."""
        k, _, amplitude = self.waves.T
        steepest = np.abs(self.treads.slope).max() if self.treads else 0.0
        return float(np.abs(k * amplitude).sum() / self._boom_length + steepest)

    def tread_at(self, yaw: float) -> int:
        """Number of the tread at a boom angle ψ [rad] of the foot; 0 without treads."""
        return self.treads.at(self._boom_length * (yaw % (2 * pi))) if self.treads else 0

    def tread_height(self, yaw: float) -> float:
        """Height of the tread at a boom angle ψ [rad] of the foot, [m]."""
        return self.treads.height_at(self._boom_length * (yaw % (2 * pi))) if self.treads else 0.0

    def height(self, yaw: float) -> float:
        """Height of the ground at a boom angle ψ [rad] of the foot, [m]."""
        waves = sum(amplitude * sin(k * yaw + phase) for k, phase, amplitude in self.waves.tolist())
        return waves + self.tread_height(yaw) if self.treads else waves


def carried_mass(robot: RobotParameters, gap: RealityGap) -> float:
    """Mass at the boom's tip: body and links [kg]."""
    links = 2 * (robot.top_mass + robot.bottom_mass)
    return gap.body_mass_scale * robot.body_mass + gap.leg_mass_scale * links


def gravity(robot: RobotParameters, gap: RealityGap, floor_yaw: float = 0.0) -> NDArray[np.float64]:
    """Gravity in the frame of the boom's tilted axis, with the floor turned by an angle [rad]; shape (3,) [m/s²]."""
    tilt = gap.boom_tilt if gap.boom_arc else 0.0
    return robot.gravity * np.array([sin(tilt) * sin(floor_yaw), sin(tilt) * cos(floor_yaw), -cos(tilt)])


def build_spec(
    robot: RobotParameters, gap: RealityGap, timestep: float, visual: bool = False, risers: bool = False
) -> mujoco.MjSpec:
    """Builds the twin as an editable MuJoCo specification.

    Args:
        robot: Robot of the physics model.
        gap: Differences of the twin from it.
        timestep: Physics step [s].
        visual: Whether to add visible shapes, which have no mass and collide with nothing.
        risers: Whether there is a riser that stops the foot.

    Raises:
        ValueError: The boom is elastic but has no inertia.
    """
    spec = mujoco.MjSpec()
    spec.modelname = "stepgap_twin"
    _set_options(spec, robot, gap, timestep)
    hopper = _add_boom(spec, robot, gap)
    _add_leg(spec, hopper, robot, gap)
    _close_four_bar(spec, timestep)
    _add_start_locks(spec, gap, timestep)
    _add_motors(spec, gap)
    _add_ground(spec, gap, ("ground", "riser") if risers else ("ground",))
    if visual:
        _add_shapes(spec, robot, gap)
    return spec


def build_model(
    robot: RobotParameters, gap: RealityGap, timestep: float, risers: bool = False, tick: float = 1e-3
) -> mujoco.MjModel:
    """Builds the compiled model of the twin, with the ground's stiffness in N/m and with memory for its drives.

    Args:
        robot: As for `build_spec`.
        timestep: As for `build_spec`.
        risers: As for `build_spec`.
        tick: Time from one command to the drives to the next [s].
    """
    spec = build_spec(robot, gap, timestep, risers=risers)
    spec.nuserdata = memory_size(gap.delay / tick)
    model = spec.compile()
    _set_contact(model, robot, gap)
    return model


def export_xml(robot: RobotParameters, gap: RealityGap, timestep: float, start: NDArray[np.float64]) -> str:
    """Returns the twin as MJCF, with visible shapes and the contact as set by `build_model`.

    Args:
        robot: As for `build_spec`.
        timestep: As for `build_spec`.
        start: Coordinates of the pose that is stored as keyframe `start`; shape (nq,).
    """
    spec = build_spec(robot, gap, timestep, visual=True)
    _add_drives(spec, gap, timestep)
    spec.add_key(name="start", qpos=start)
    model = spec.compile()
    _set_contact(model, robot, gap)
    pair = spec.pairs[0]
    pair.solref = model.pair_solref[0]
    pair.solimp = model.pair_solimp[0]
    pair.solreffriction = model.pair_solreffriction[0]
    spec.compile()
    return spec.to_xml()


def _set_options(spec: mujoco.MjSpec, robot: RobotParameters, gap: RealityGap, timestep: float) -> None:
    off = mujoco.mjtDisableBit
    spec.compiler.degree = False
    option = spec.option
    option.timestep = timestep
    option.gravity = gravity(robot, gap)
    option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    option.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
    option.impratio = 1e5
    option.iterations = 20
    option.tolerance = 1e-10
    option.disableflags = (
        off.mjDSBL_LIMIT | off.mjDSBL_AUTORESET | off.mjDSBL_MIDPHASE | off.mjDSBL_CLAMPCTRL | off.mjDSBL_ISLAND
    )


def _add_boom(spec: mujoco.MjSpec, robot: RobotParameters, gap: RealityGap) -> mujoco.MjsBody:
    """Adds the body at the tip. The boom has inertia but no weight, so it is armature of the joints at its root."""
    radius = robot.boom_length
    inertia_x, inertia_z = (
        gap.boom_inertia_scale * value for value in (robot.boom_inertia_vertical, robot.boom_inertia_horizontal)
    )
    hinge = mujoco.mjtJoint.mjJNT_HINGE
    slide = mujoco.mjtJoint.mjJNT_SLIDE
    hopper = spec.worldbody.add_body(name="hopper")
    hopper.explicitinertial = True
    hopper.mass = gap.body_mass_scale * robot.body_mass
    hopper.ipos = np.array([gap.body_com_offset, 0, 0])
    hopper.inertia = np.full(3, 1e-6)  # the inertia of the body is part of the boom's
    if gap.boom_arc:
        hopper.pos = np.array([0, -radius, gap.boom_pivot_height])
        pivot = np.array([0, radius, 0])
        yaw = hopper.add_joint(name="boom_horizontal", type=hinge, axis=UP, pos=pivot, armature=inertia_z)
        yaw.frictionloss = radius * gap.boom_friction
        yaw.damping[0] = radius**2 * gap.boom_drag
        hopper.add_joint(name="boom_vertical", type=hinge, axis=PITCH_AXIS, pos=pivot, armature=inertia_x)
    else:
        travel = hopper.add_joint(name="boom_horizontal", type=slide, axis=FORWARD, armature=inertia_z / radius**2)
        travel.frictionloss = gap.boom_friction
        travel.damping[0] = gap.boom_drag
        hopper.add_joint(name="boom_vertical", type=slide, axis=UP, armature=inertia_x / radius**2)
    if gap.boom_stiffness < inf:
        has_inertia = min(inertia_x, inertia_z) > 0
        require(has_inertia, "boom_stiffness", gap.boom_stiffness, "be inf for a boom without inertia")
        damping = 2 * gap.boom_damping_ratio * sqrt(gap.boom_stiffness * carried_mass(robot, gap))
        for name, axis in (("deflection_horizontal", FORWARD), ("deflection_vertical", UP)):
            joint = hopper.add_joint(name=name, type=slide, axis=axis)
            joint.stiffness[0] = gap.boom_stiffness
            joint.damping[0] = damping
    return hopper


def _add_leg(spec: mujoco.MjSpec, hopper: mujoco.MjsBody, robot: RobotParameters, gap: RealityGap) -> None:
    """Adds two chains of top and bottom link, which hang straight down at zero; motor 1 drives the front one."""
    for motor, side in ((1, "front"), (2, "rear")):
        top = hopper.add_body(name=f"{side}_top")
        _add_link_inertia(top, robot.top_mass, robot.top_inertia, robot.top_com, gap)
        _add_hinge(top, f"motor_{motor}", gap, gap.rotor_inertia)
        bottom = top.add_body(name=f"{side}_bottom", pos=(0, 0, -robot.top_length))
        _add_link_inertia(bottom, robot.bottom_mass, robot.bottom_inertia, robot.bottom_com, gap)
        _add_hinge(bottom, f"knee_{motor}", gap, 0)
        bottom.add_site(name=f"{side}_joint", pos=(0, 0, -robot.bottom_length), size=[0.001, 0, 0])
        if side == "rear":
            tip = (0, 0, -robot.bottom_length - robot.foot_length)
            bottom.add_geom(name="foot", pos=tip, size=[FOOT_RADIUS, 0, 0], contype=0, conaffinity=0)
            bottom.add_site(name="foot", pos=tip, size=[1, 0, 0], group=5)  # large, to sense contact at any depth
            spec.add_sensor(
                name="contact_force",
                type=mujoco.mjtSensor.mjSENS_TOUCH,
                objtype=mujoco.mjtObj.mjOBJ_SITE,
                objname="foot",
            )


def _add_link_inertia(link: mujoco.MjsBody, mass: float, inertia: float, com: float, gap: RealityGap) -> None:
    """Sets the inertia of a slender rod along −z; the inertia about its own axis hardly matters."""
    inertia *= gap.leg_inertia_scale
    link.explicitinertial = True
    link.mass = gap.leg_mass_scale * mass
    link.ipos = np.array([0, 0, -com])
    link.inertia = np.array([inertia, inertia, 0.01 * inertia])


def _add_hinge(link: mujoco.MjsBody, name: str, gap: RealityGap, armature: float) -> None:
    joint = link.add_joint(name=name, axis=LEG_AXIS, armature=armature, frictionloss=gap.joint_friction)
    joint.damping[0] = gap.joint_damping


def _close_four_bar(spec: mujoco.MjSpec, timestep: float) -> None:
    closure = spec.add_equality(name="four_bar", name1="front_joint", name2="rear_joint")
    closure.type = mujoco.mjtEq.mjEQ_CONNECT
    closure.objtype = mujoco.mjtObj.mjOBJ_SITE
    closure.solref = _deadbeat(timestep)
    closure.solimp = np.array(HARD)


def _add_start_locks(spec: mujoco.MjSpec, gap: RealityGap, timestep: float) -> None:
    """Adds the locks that hold the hip before the start; the twin switches them off."""
    names = ["boom_horizontal", "boom_vertical"]
    if gap.boom_stiffness < inf:
        names += ["deflection_horizontal", "deflection_vertical"]
    for name in names:
        lock = spec.add_equality(name=f"hold_{name}", name1=name, active=False)
        lock.type = mujoco.mjtEq.mjEQ_JOINT
        lock.objtype = mujoco.mjtObj.mjOBJ_JOINT
        lock.solref = _deadbeat(timestep)
        lock.solimp = np.array(HARD)


def with_timestep(model: mujoco.MjModel, timestep: float) -> mujoco.MjModel:
    """Returns a copy of the model with another physics step [s], in which it closes the four-bar as quickly.

    Only for motions without contact: its constants remain those of the other step.
    """
    changed = copy(model)
    changed.opt.timestep = timestep
    changed.eq_solref[:] = _deadbeat(timestep)
    return changed


def _deadbeat(timestep: float) -> NDArray[np.float64]:
    """Spring and damper constants (negative: per unit mass) that remove a constraint's error within one step."""
    return np.array([-1 / timestep**2, -1 / timestep])


def _add_motors(spec: mujoco.MjSpec, gap: RealityGap) -> None:
    """Adds the motors with their scales; they are given the torques of the drives."""
    for name, share in (("motor_1", 1 + gap.torque_imbalance), ("motor_2", 1 - gap.torque_imbalance)):
        motor = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        motor.gainprm[0] = gap.torque_scale * share


def _add_drives(spec: mujoco.MjSpec, gap: RealityGap, timestep: float) -> None:
    """Adds the drives to the motors: torque command → delay, rounded to steps → first-order lag."""
    steps = round(gap.delay / timestep)
    for motor in spec.actuators:
        if gap.torque_lag > 0:
            motor.dyntype = mujoco.mjtDyn.mjDYN_FILTEREXACT
            motor.dynprm[0] = gap.torque_lag
        if steps > 0:
            # half a step less: MuJoCo finds the command by its time, and rounding could otherwise add a step
            motor.delay = (steps - 0.5) * timestep
            motor.nsample = steps + 1


def _add_ground(spec: mujoco.MjSpec, gap: RealityGap, names: tuple[str, ...]) -> None:
    """Adds level planes that can be moved and that collide only with the foot."""
    friction = STICKING if isinf(gap.ground_friction) else gap.ground_friction
    for name in names:
        ground = spec.worldbody.add_body(name=name, mocap=True)
        plane = ground.add_geom(name=name, type=mujoco.mjtGeom.mjGEOM_PLANE, pos=(0, 0, -FOOT_RADIUS))
        plane.size = np.array([4, 4, 0.05])
        plane.contype = plane.conaffinity = 0
        pair = spec.add_pair(name=f"foot_{name}", geomname1="foot", geomname2=name, condim=3)
        pair.friction = np.array([friction, friction, 0, 0, 0])


class FootContact(NamedTuple):
    """MuJoCo's numbers of a contact: impedance, spring and damper, those of friction, and its coefficient."""

    impedance: float
    spring: float
    damper: float
    slip: float
    friction: float


def contact_of(
    model: mujoco.MjModel, robot: RobotParameters, gap: RealityGap, stiffness: float = 1.0, friction: float = 1.0
) -> FootContact:
    """MuJoCo's numbers of the contact with a ground.

    MuJoCo's contact force is f = −(a + b v + k r)/R for penetration −r and acceleration a, with
    R = w (1 − d)/d, impedance d and the constant inverse weight w of the foot; −solref is (k d, b d).
    So k/R is a stiffness [N/m], b/R a damping [N·s/m] and 1/R a mass [kg] coupled to the foot in contact.
    On soft ground that mass is as small as an explicit step of spring and damper allows. Rigid ground
    stops the foot within a few steps, without a bounce, and yields by micrometres.

    Args:
        robot: As for `build_spec`.
        stiffness: Stiffness as a part of the gap's; no effect on rigid ground.
        friction: Coefficient of friction as a part of the gap's; no effect where the foot never slips.
    """
    step = model.opt.timestep
    sticks = isinf(gap.ground_friction)
    foot_mass = 0.25 * gap.leg_mass_scale * 2 * (robot.top_mass + robot.bottom_mass)
    if not isinf(gap.ground_stiffness):
        stiffness *= gap.ground_stiffness
        damping = 2 * gap.ground_damping_ratio * sqrt(stiffness * carried_mass(robot, gap))
        mass = max(0.5 * (damping * step + stiffness * step**2) - foot_mass, 1e-3)
    else:
        mass = (RIGID_SHARE if sticks else 0.5) * foot_mass
        damping = (mass + foot_mass) / step
        stiffness = RECOVERY_RATE * damping
    weighted = mass * model.body_invweight0[model.geom("foot").bodyid[0], 0]
    impedance = weighted / (1 + weighted)
    return FootContact(
        impedance=impedance,
        spring=-stiffness / mass * impedance,
        damper=-damping / mass * impedance,
        slip=-impedance * (1 / step if sticks else (1 - exp(-SLIP_RATE * step)) / step),
        friction=STICKING if sticks else friction * gap.ground_friction,
    )


def _set_contact(model: mujoco.MjModel, robot: RobotParameters, gap: RealityGap) -> None:
    """Sets the spring and damper constants of all contacts."""
    contact = contact_of(model, robot, gap)
    for pair in range(model.npair):
        model.pair_solimp[pair] = [contact.impedance, contact.impedance, 0.001, 0.5, 2]
        model.pair_solref[pair] = [contact.spring, contact.damper]
        model.pair_solreffriction[pair] = [-1, contact.slip]


def _add_shapes(spec: mujoco.MjSpec, robot: RobotParameters, gap: RealityGap) -> None:
    """Adds visible shapes of boom, body and links."""
    capsule = mujoco.mjtGeom.mjGEOM_CAPSULE
    cylinder = mujoco.mjtGeom.mjGEOM_CYLINDER
    dark = (0.2, 0.2, 0.25, 1)
    blue = (0.15, 0.45, 0.75, 1)
    orange = (0.85, 0.4, 0.15, 1)

    def add(body: str, kind: mujoco.mjtGeom, ends: list[float], radius: float, colour: tuple[float, ...]) -> None:
        shape = spec.body(body).add_geom(type=kind, fromto=ends, size=[radius, 0, 0], rgba=colour, group=1)
        shape.contype = shape.conaffinity = 0

    spec.worldbody.add_light(pos=(0, -1, 3), dir=(0, 0, -1))
    _add_squares(spec)
    add("hopper", cylinder, [0, -0.03, 0, 0, 0.03, 0], 0.046, dark)
    if gap.boom_arc:
        add("hopper", capsule, [0, 0, 0, 0, robot.boom_length, 0], 0.015, dark)
    for side, colour, foot in (("front", blue, 0), ("rear", orange, robot.foot_length)):
        for part, length in (("top", robot.top_length), ("bottom", robot.bottom_length + foot)):
            add(f"{side}_{part}", capsule, [0, 0, 0, 0, 0, -length], 0.007, colour)


def _add_squares(spec: mujoco.MjSpec) -> None:
    """Adds a floor with squares, on which the robot's motion is visible."""
    two_d = mujoco.mjtTexture.mjTEXTURE_2D
    checker = mujoco.mjtBuiltin.mjBUILTIN_CHECKER
    squares = spec.add_texture(name="squares", type=two_d, builtin=checker, width=256, height=256)
    squares.rgb1 = np.full(3, 0.8)
    squares.rgb2 = np.full(3, 0.7)
    material = spec.add_material(name="squares", texrepeat=(1, 1), texuniform=True)
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "squares"
    spec.geom("ground").material = "squares"

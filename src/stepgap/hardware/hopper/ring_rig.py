"""The twin behind an emulated ring as a `Rig`: the whole path of a robot on EtherCAT without hardware."""

from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace

from stepgap.hardware.ethercat.distributed_clocks import SYNC0_ONLY
from stepgap.hardware.ethercat.emulator.drive import ELMO_GOLD
from stepgap.hardware.ethercat.emulator.emulator import emulated
from stepgap.hardware.ethercat.emulator.network import NoNetwork
from stepgap.hardware.ethercat.emulator.ring import Machine
from stepgap.hardware.ethercat.emulator.ring_settings import RingSettings
from stepgap.hardware.ethercat.emulator.terminals import ANALOG_IDENTITY, COUPLER_IDENTITY, ENCODER_IDENTITY
from stepgap.hardware.ethercat.pdo import Pdo
from stepgap.hardware.ethercat.pdo_sets import PDO_SETS
from stepgap.hardware.ethercat.rig_settings import Encoder, Motor, Slave, WrittenPdo, WrittenPdoSet
from stepgap.hardware.hopper.ethercat import Contact, RigSettings, hopper_on_ethercat
from stepgap.rigs.rig import RigFault
from stepgap.rigs.wrapped_rig import WrappedRig
from stepgap.robots.ground import FLAT_GROUND, UnevenGround
from stepgap.robots.hopper.parameters import RobotParameters
from stepgap.robots.hopper.tick.limits import SafetyLimits
from stepgap.robots.hopper.tick.sensors import HopperSensorModel

INTERFACE = "stepgap0"  # Name of the network interface that a master opens

PATIENT_REPLY = 0.45
"""Timeout for a frame of a ring in lock-step [s]; its simulated time stands still while a frame is awaited."""

PATIENT_WATCHDOG = 0.5
"""Watchdog time of a ring in lock-step [s], the longest allowed; such a ring counts its own ticks."""


def _written(pdo: Pdo, *more: str) -> WrittenPdo:
    """A PDO as a `rig.toml` describes it, with more entries."""
    return WrittenPdo(index=pdo.index, entries=(*map(str, pdo.entries), *more))


_MOTION, _VELOCITY = PDO_SETS["elmo-cst"].inputs
_DRIVE_PDOS = WrittenPdoSet(
    name="emulated-drive",
    outputs=tuple(map(_written, PDO_SETS["elmo-cst"].outputs)),
    inputs=(
        _written(_MOTION),
        _written(_VELOCITY, "0x2100:00:16 temperature", "0x6079:00:32 bus_voltage", "0x60FD:00:32 digital_inputs"),
    ),
)
"""The set `elmo-cst`, and what else an emulated drive reports: its temperature is not an object of CiA 402."""

_DEVICES = (
    ("drive_1", ELMO_GOLD, _DRIVE_PDOS.name),
    ("drive_2", ELMO_GOLD, _DRIVE_PDOS.name),
    ("coupler", COUPLER_IDENTITY, "none"),
    ("boom_horizontal", ENCODER_IDENTITY, "beckhoff-el5151"),
    ("boom_vertical", ENCODER_IDENTITY, "beckhoff-el5151"),
    ("contact_force", ANALOG_IDENTITY, "analog-input"),
)
"""Slaves of `hopper_devices` and their sets of PDOs."""


def emulated_settings(
    sensor_model: HopperSensorModel,
    robot: RobotParameters,
    ring: RingSettings,
    interface: str = INTERFACE,
    ground: UnevenGround = FLAT_GROUND,
) -> RigSettings:
    """Settings, as in a `rig.toml`, of an emulated ring whose encoders count from zero, forward positive.

    Args:
        sensor_model: Sensor model of the twin behind the ring.
        robot: Robot whose torque limit the motors have, as far as the drives allow.
        ground: Ground on which the twin hops, whose changes the limits allow.
    """
    rated = ring.rated_torque / 1000
    most = min(robot.torque_limit, rated * ring.largest_torque / 1000)
    drive = Motor(
        slave="drive_1",
        counts_per_turn=sensor_model.motor_counts,
        rated_torque=rated,
        torque_limit=most,
        temperature_unit=0.1,
        temperature_warning=80.0,
        temperature_limit=90.0,
        bus_voltage=(30.0, 65.0),
        sto_bits=(16, 17),
        enable_bits=(18,),
    )
    return RigSettings(
        interface=interface,
        pivot_height=sensor_model.pivot_height,
        slaves=_slaves(ring),
        pdo_sets=(_DRIVE_PDOS,),
        motor_1=drive,
        motor_2=replace(drive, slave="drive_2"),
        boom_horizontal=Encoder(slave="boom_horizontal", counts_per_turn=sensor_model.boom_counts_horizontal),
        boom_vertical=Encoder(slave="boom_vertical", counts_per_turn=sensor_model.boom_counts_vertical),
        contact=Contact(
            slave="contact_force",
            newton_per_count=ring.force_resolution,
            touchdown_force=sensor_model.touchdown_force,
            takeoff_length=sensor_model.takeoff_length,
        ),
        limits=_limits(most, 0.1 if ring.lock_step else 1.0, 0.03 + ground.largest_change),
        tick=sensor_model.tick,
        reply_timeout=PATIENT_REPLY if ring.lock_step else sensor_model.tick / 2,
        watchdog=PATIENT_WATCHDOG if ring.lock_step else 0.05,
    )


def _slaves(ring: RingSettings) -> tuple[Slave, ...]:
    """The devices, with SYNC0 where the ring needs it."""
    return tuple(
        Slave(
            name=name,
            vendor=identity.vendor,
            product=identity.product,
            pdos=pdos,
            assign_activate=SYNC0_ONLY if name in ring.clocks.need_sync0 else 0,
        )
        for name, identity, pdos in _DEVICES
    )


def _limits(torque: float, jitter: float, ground: float) -> SafetyLimits:
    """Complete limits, which a hopping twin never reaches: it cannot break."""
    return SafetyLimits(
        torque=torque,
        torque_step=2 * torque,
        lean_angle=1.5,
        fold_angle=3.0,
        shortest_leg=0.09,
        longest_leg=0.32,
        lowest_hip=0.05,
        highest_hip=2.0,
        lost_frames=5,
        stale_ticks=5,
        late_ticks=40,
        simulated=True,
        continuous_torque=torque,
        overload_time=1.0,
        mean_power=1e4,
        posture_torque=5.0,
        posture_speed=20.0,
        first_share=1.0,
        first_hops=1,
        brake_torque=10.0,
        jump_angle=0.004,
        sample_jitter=jitter,
        frozen_time=0.016,
        ground_height=ground,
        motion_torque=2.0,
    )


class RingRig(WrappedRig):
    """A machine behind an emulated ring that runs in a separate process while the rig is connected.

    Args:
        make_machine: Makes the machine that the drives move, in that process; must be picklable.
        settings: Settings of the master.
        robot: Robot whose boom length the sensor model uses.
    """

    def __init__(
        self, make_machine: Callable[[], Machine], ring: RingSettings, settings: RigSettings, robot: RobotParameters
    ):
        super().__init__(hopper_on_ethercat(settings, robot))
        self._make_machine = make_machine
        self._ring = ring
        self._settings = settings
        self._robot = robot
        self._running = ExitStack()

    def connect(self) -> None:
        """Starts the ring with its machine in the starting pose, and brings the bus up like a real one.

        Raises:
            RigFault: No ring can run on this computer (the message gives the remedy), or as for `EthercatRig`.
        """
        self.close()
        try:
            self._running.enter_context(emulated(self._settings.interface, self._make_machine, self._ring))
        except NoNetwork as reason:
            raise RigFault(str(reason)) from None
        self._rig = hopper_on_ethercat(self._settings, self._robot)
        try:
            self._running.enter_context(self._rig)
        except BaseException:
            self.close()  # or the ring would keep its interface
            raise

    def close(self) -> None:
        """Switches torque off and ends bus and ring; may be called twice."""
        self._running.close()

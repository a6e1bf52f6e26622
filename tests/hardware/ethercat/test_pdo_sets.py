"""Every set of PDOs of a drive: brought up to OP with a drive that has it, torque in, position out, in lock-step."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from pathlib import Path

import pytest

from stepgap.hardware.ethercat.distributed_clocks import COMPUTER
from stepgap.hardware.ethercat.emulator.device import EmulatedDevice
from stepgap.hardware.ethercat.emulator.drive import ELMO_GOLD, Drive, DriveLayout, DriveSettings
from stepgap.hardware.ethercat.emulator.ring_settings import RingSettings
from stepgap.hardware.ethercat.emulator.sii import Identity
from stepgap.hardware.ethercat.ethercat_rig import EthercatRig
from stepgap.hardware.ethercat.pdo import Packing, Pdo
from stepgap.hardware.ethercat.pdo_sets import PDO_SETS
from stepgap.hardware.ethercat.rig_settings import BusSettings, Motor, RigDevice, Slave
from stepgap.rigs.limits import RigLimits
from stepgap.rigs.rig import Reading, RigFault, SensorModel, Torques
from tests.hardware.ethercat.ring_process import INTERFACE, RecordingMachine, live_ring

pytest.importorskip("pysoem", reason="pysoem is locked for Linux only")

IDENTITIES = {
    "elmo-cst": ELMO_GOLD,
    "maxon-epos4-cst": Identity("EPOS4", 0x000000FB, 0x63500000),
    "synapticon-somanet-cst": Identity("Circulo 9", 0x000022D2, 0x00000301, 0x0C000000),
    "delta-asda-a2-cst": Identity("ASDA-A2-E CoE Drive", 0x000001DD, 0x10305070, 0x02040608),
    "panasonic-minas-cst": Identity("MBDLN25BE", 0x0000066F, 0x60380006),
}
"""Every set of a drive, with the identity that its source states."""

DRIVE_SETS = [name for name, pdos in PDO_SETS.items() if "target_torque" in Packing(pdos.outputs).names]

OTHER_RESOLUTION = {"maxon-epos4-cst": 1e-6}
"""Units of the rated torque in the emulated drives [N·m] if not 0.001."""

COUNTS_PER_TICK = 7
INDICES = {
    "controlword": 0x6040,
    "statusword": 0x6041,
    "mode": 0x6060,
    "mode_display": 0x6061,
    "position": 0x6064,
    "velocity": 0x606C,
    "target_torque": 0x6071,
    "torque": 0x6077,
    "error_code": 0x603F,
    "digital_inputs": 0x60FD,
}
LIMITS_AT_ZERO = {0x6072, 0x6080, 0x607F, 0x60E0, 0x60E1}
"""Objects with which a drive does not move if the master sends zero: largest torque and speeds."""


@dataclass(frozen=True, kw_only=True)
class OneDrive(BusSettings):
    """A bus with one drive."""

    motor: Motor

    @property
    def devices(self) -> Mapping[str, RigDevice]:
        return {"motor": self.motor}

    @property
    def budgets(self) -> RigLimits:
        return RigLimits()


def layout_of(name: str, mappable: bool) -> DriveLayout:
    """A drive whose PDOs are those of a set after power-up."""
    found = PDO_SETS[name]
    outputs, inputs = (tuple(pdo.index for pdo in pdos) for pdos in (found.outputs, found.inputs))
    return DriveLayout(found.outputs, found.inputs, outputs, inputs, mappable)


class OneDriveMachine(RecordingMachine):
    """A motor whose encoder counts ticks."""

    def __init__(self, name: str, layout: DriveLayout):
        self.torques, self._name, self._layout = [], name, layout

    @property
    def period(self) -> float:
        return 1e-3

    def devices(self, settings: RingSettings) -> list[EmulatedDevice]:
        unit = OTHER_RESOLUTION.get(self._name, 1e-3)
        drive = DriveSettings(
            identity=IDENTITIES[self._name],
            layout=self._layout,
            rated_torque=round(2.0 / unit),
            rated_torque_unit=unit,
            largest_torque=settings.largest_torque,
            period=self.period,
        )
        return [Drive("drive", drive, lambda reading: reading[0])]

    def start(self) -> Reading:
        self.torques = []
        return (0.0,)

    def tick(self, torques: Torques) -> Reading:
        self.torques.append(torques)
        return (float(COUNTS_PER_TICK * len(self.torques)),)


def rig_for(name: str, pdos: str, unit: float | None = None, folder: Path = Path(), **others: int | str) -> EthercatRig:
    identity = IDENTITIES[name]
    slave = Slave(name="drive", vendor=identity.vendor, product=identity.product, pdos=pdos)
    motor = Motor(
        slave="drive",
        counts_per_turn=4096,
        rated_torque=2.0,
        rated_torque_unit=unit or OTHER_RESOLUTION.get(name, 1e-3),
        torque_limit=4.0,
    )
    settings = OneDrive(
        interface=INTERFACE,
        slaves=(replace(slave, **others),),
        motor=motor,
        reply_timeout=0.45,  # a busy machine may keep the ring waiting
        watchdog=0.5,
    )
    return EthercatRig(settings, SensorModel(tick=settings.tick), COMPUTER, folder)


def drive_ring(name: str, layout: DriveLayout):
    return live_ring(make_machine=partial(OneDriveMachine, name, layout))


@pytest.mark.parametrize("name", DRIVE_SETS)
def test_a_drive_with_these_pdos_takes_torque_and_returns_its_position(name: str) -> None:
    """Its PDOs cannot be written here: it has them after power-up."""
    with drive_ring(name, layout_of(name, mappable=False)) as ring, rig_for(name, name) as rig:
        positions, sent = [rig.read()[0]], []
        for torque in (0.5, -1.0, 1.5, -4.0, 4.0):
            sent.append(rig.write((torque,)))
            positions.append(rig.read()[0])
        torques = ring.look().torques[-5:]
        assert torques == [pytest.approx(each) for each in sent] == [(0.5,), (-1.0,), (1.5,), (-4.0,), (4.0,)]
        assert [after - before for before, after in pairwise(positions)] == [COUNTS_PER_TICK] * 5
        inputs = rig._bus.inputs(0)
        assert inputs["position"] == positions[-1]
        assert inputs["velocity"] == 1000 * COUNTS_PER_TICK
        assert inputs["torque"] == 2000, "4 N·m are twice the rated torque"
        assert inputs.get("mode_display", 10) == 10
        assert inputs.get("error_code", 0) == 0
        logged = {"statusword", "velocity", "torque", "digital_inputs"} & inputs.keys()
        assert set(rig.diagnostic_units) == {f"motor_{name}" for name in logged}


@pytest.mark.parametrize("name", ["maxon-epos4-cst", "synapticon-somanet-cst"])
def test_its_pdos_are_written_where_it_allows_this(name: str) -> None:
    """The drive has the PDOs of this set, with other contents after power-up."""
    own = layout_of(name, mappable=True)
    first, *others = own.outputs
    all_objects = Pdo(0x16FF, tuple(entry for pdo in own.outputs for entry in pdo.entries))
    outputs = replace(first, entries=first.entries[:1]), *others, all_objects
    inputs = tuple(replace(pdo, entries=pdo.entries[::-1]) for pdo in own.inputs)
    other = DriveLayout(outputs, inputs, own.assigned_outputs[:1], own.assigned_inputs[:1])
    with drive_ring(name, other) as ring, rig_for(name, name) as rig:
        rig.write((-1.5,))
        rig.read()
        assert ring.look().torques[-1] == (pytest.approx(-1.5),)


@pytest.mark.parametrize("name", DRIVE_SETS)
def test_another_drive_is_refused(name: str) -> None:
    other = DRIVE_SETS[DRIVE_SETS.index(name) - 1]
    refused = pytest.raises(RigFault, match=r"slave 1 'drive'.*(is refused|must map)")
    with drive_ring(name, layout_of(name, mappable=False)), refused, rig_for(name, other):
        pass


PAGE = Path(__file__).parents[3] / "docs" / "esi.md"


@pytest.mark.parametrize("name", DRIVE_SETS)
def test_the_page_describes_the_set(name: str) -> None:
    """Its identity, and its first and last PDOs, in the first of its two tables."""
    (row, _) = re.findall(rf"^\| `{name}` \|.*$", PAGE.read_text("utf-8"), re.MULTILINE)
    identity, found = IDENTITIES[name], PDO_SETS[name]
    for pdos, cell in zip((found.outputs, found.inputs), row.split("|")[3:5], strict=True):
        assert re.findall(r"0x\w{4}", cell)[0] == f"0x{pdos[0].index:04X}"
        assert re.findall(r"0x\w{4}", cell)[-1] == f"0x{pdos[-1].index:04X}"
        assert ("digital inputs" in cell) == ("digital_inputs" in Packing(pdos).names)
    assert f"vendor 0x{identity.vendor:X}" in row
    assert f"0x{identity.product:08X}" in row


DELTA_ESI = """<EtherCATInfo><Vendor><Id>#x1DD</Id></Vendor><Descriptions><Devices><Device>
<Type ProductCode="#x10305070" RevisionNo="#x02040607">ASDA</Type><Name>Drive</Name>
<RxPdo Sm="2"><Index>#x1603</Index><Entry><Index>#x6040</Index><SubIndex>0</SubIndex><BitLen>16</BitLen></Entry>
<Entry><Index>#x6071</Index><SubIndex>0</SubIndex><BitLen>16</BitLen></Entry></RxPdo>
<TxPdo Sm="3"><Index>#x1A00</Index><Entry><Index>#x6041</Index><SubIndex>0</SubIndex><BitLen>16</BitLen></Entry></TxPdo>
<Mailbox><CoE PdoAssign="1" PdoConfig="1"/></Mailbox></Device></Devices></Descriptions></EtherCATInfo>"""


def test_the_revision_on_the_bus_is_compared_with_an_esi_file(tmp_path: Path) -> None:
    """What can be known before the rig is connected, and what only its device can tell."""
    name = "delta-asda-a2-cst"
    (tmp_path / "delta.xml").write_text(DELTA_ESI)
    rig = rig_for(name, name, folder=tmp_path, esi="delta.xml")
    label = "slave 1 'drive', delta.xml: "
    contents = f"{label}pdos: PDO 0x1A00 has 0x6064:00:32 position at bit 16, but no entry according to the file"
    before = [finding.text for finding in rig.findings()]
    assert before == [f"{contents}; the rig writes the contents of rig.toml"]
    with drive_ring(name, layout_of(name, mappable=False)), rig:
        (doubt, *others) = [finding.text for finding in rig.findings()]
    assert others == before
    assert doubt.startswith(f"{label}the device has revision 0x02040608, but the file describes 0x02040607; get")


def test_another_revision_is_refused_where_one_is_given() -> None:
    name = "delta-asda-a2-cst"
    with drive_ring(name, layout_of(name, mappable=False)):
        with rig_for(name, name, revision=0x02040608):
            pass
        message = "slave 1 'drive' must be revision 0x02040609, but there is 0x02040608"
        with pytest.raises(RigFault, match=message), rig_for(name, name, revision=0x02040609):
            pass


@pytest.mark.parametrize("name", DRIVE_SETS)
def test_names_are_those_of_the_objects_and_zero_is_no_limit(name: str) -> None:
    found = PDO_SETS[name]
    for pdo in (*found.outputs, *found.inputs):
        for entry in pdo.entries:
            assert not entry.name or (entry.index, entry.subindex) == (INDICES[entry.name], 0)
    unnamed = {entry.index for pdo in found.outputs for entry in pdo.entries if not entry.name}
    assert not unnamed & LIMITS_AT_ZERO

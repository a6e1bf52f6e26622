"""What two masters and the ring say to each other, as Wireshark understands it, which was written by others."""

from typing import Any

import pytest

from stepgap.hardware.ethercat.emulator.faults import Fault
from tests.hardware.ethercat.dissection import Dissected, dissected, needs_tshark
from tests.hardware.ethercat.emulator.bench import DRIVES
from tests.hardware.ethercat.emulator.kickcat_master import KickcatMaster
from tests.hardware.ethercat.emulator.soem_master import cycle, enabled, pysoem, soem_master
from tests.hardware.ethercat.recording import recording
from tests.hardware.ethercat.ring_process import INTERFACE, live_ring

pytestmark = needs_tshark

FAULTS = (
    Fault("lost frames", 10, cycles=2),
    Fault("late frame", 14),
    Fault("duplicated frame", 18),
    Fault("emergency", 20, "drive_2", code=0x4210),
    Fault("trip", 24, "drive_1", code=0x2310),
    Fault("unplugged", 28, "contact_force", cycles=3),
    Fault("power lost", 34, "boom_vertical", cycles=3),
    Fault("silence", 40, ticks=200),
)
CYCLES = 60
A_WHILE = 0.05
EMERGENCY, SDO_REQUEST, SDO_RESPONSE, SDO_INFORMATION = "1", "2", "3", "8"
OF_SOEM = "Source MAC must not be a group address: IEEE 802.3-2002, Section 3.2.3(b)"
"""Remark on SOEM's source addresses, 01:01:01:01:01:01 among others, which the ring passes on."""


def test_wireshark_understands_every_frame_of_soem(tmp_path):
    with live_ring(*FAULTS, frames=tmp_path / "soem.pcap"), soem_master(INTERFACE) as bus:
        run_with_soem(bus)
    frames = dissected(tmp_path / "soem.pcap")
    check(frames, {OF_SOEM})
    assert {frame.abort for frame in frames} == {"", "0x06020000", "0x06010002", "0x06010000"}
    assert {frame.refusal for frame in frames} == {"", "0x05040001"}
    assert messages(frames).count(EMERGENCY) == 3  # as scripted, and the watchdog of drive_2


def run_with_soem(bus: Any) -> None:
    """Bring-up, cycles with all faults, objects and their refusals."""
    enabled(bus)
    for _ in range(CYCLES):
        cycle(bus, 100, -100)
    drive = bus.slaves[0]
    for slave in DRIVES * 2:
        bus.slaves[slave].mbx_receive()
    drive.sdo_read(0x1008, 0)
    for call, arguments in (
        (drive.sdo_read, (0x2000, 0)),
        (drive.sdo_write, (0x6041, 0, b"\0\0")),
        (drive.sdo_read, (0x1018, 0, 64, True)),
    ):
        with pytest.raises(pysoem.SdoError):
            call(*arguments)
    with pytest.raises(pysoem.SdoInfoError):
        _ = drive.od


def test_wireshark_understands_every_frame_of_kickcat(tmp_path):
    with live_ring(*FAULTS, frames=tmp_path / "kickcat.pcap"):
        run_with_kickcat(KickcatMaster(INTERFACE))
    frames = dissected(tmp_path / "kickcat.pcap")
    check(frames, set())
    assert {frame.abort for frame in frames} == {"", "0x06020000", "0x06010002", "0x06010000"}
    assert {frame.refusal for frame in frames} == {"", "0x05040001"}
    assert messages(frames).count(EMERGENCY) == 3


def run_with_kickcat(master: KickcatMaster) -> None:
    """The same as with SOEM."""
    master.assign_pdos()
    master.operational()
    master.enable()
    for _ in range(CYCLES):
        master.cycle(100, -100, wait=A_WHILE, checked=False)
    master.upload(0, 0x1008, 0)
    master.upload(0, 0x2000, 0, wait=A_WHILE)
    master.write(0, 0x6041, 0, b"\0\0", wait=A_WHILE)
    master.upload(0, 0x1018, 0, complete=True, wait=A_WHILE)
    with pytest.raises(master.kickcat.ErrorCoE):
        master.bus.read_object_description(master.slaves[0], 0x1018)


def check(frames: list[Dissected], remarks: set[str]) -> None:
    """Every frame is EtherCAT to its end, without other remarks than these, and there is mail in both directions."""
    services = messages(frames)
    print(f"{len(frames)} frames, {len(services)} messages, {sum(bool(frame.malformed) for frame in frames)} malformed")
    assert len(frames) > 1000
    assert {frame.protocols.split(":ecat_mailbox")[0] for frame in frames} == {"eth:ethertype:ecatf:ecat"}
    assert [frame for frame in frames if frame.malformed] == []
    assert {frame.remarks for frame in frames} <= remarks | {""}
    assert min(services.count(SDO_REQUEST), services.count(SDO_RESPONSE)) > 20
    assert services.count(SDO_INFORMATION) >= 2


def messages(frames: list[Dissected]) -> list[str]:
    """CoE services of all mailbox messages."""
    return [service for frame in frames for service in frame.service.split(",") if service]


def test_wireshark_notices_a_frame_that_is_cut(tmp_path):
    mail = bytes.fromhex(
        "ffffffffffff 101010101010 88a4 1c10 05 05 0110 0010 1000 0000 0a00 0000 00 13 0020 4018100100000000 0000"
    )
    for name, frame in (("whole", mail), ("cut", mail[:40])):
        with recording(tmp_path / name) as append:
            append(frame)
    (whole,), (cut,) = dissected(tmp_path / "whole"), dissected(tmp_path / "cut")
    assert (whole.service, whole.malformed) == (SDO_REQUEST, "")
    assert cut.malformed

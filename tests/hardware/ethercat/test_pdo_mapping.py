"""PDOs with other contents than after power-up: written where a slave allows it, refused by name where it does not."""

from dataclasses import replace

import pytest

from stepgap.hardware.ethercat.rig_settings import WrittenPdo, WrittenPdoSet
from stepgap.rigs.rig import RigFault
from tests.hardware.ethercat.ring_process import Recorder, live_ring
from tests.hardware.ethercat.test_ethercat_rig import SETTINGS, rig_of

pytest.importorskip("pysoem", reason="pysoem is locked for Linux only")

OWN = WrittenPdoSet(
    name="own",
    outputs=(
        WrittenPdo(
            index=0x160B,
            entries=("0x6060:00:8 mode", "0x0000:00:8", "0x6040:00:16 controlword", "0x6071:00:16 target_torque"),
        ),
    ),
    inputs=(
        WrittenPdo(
            index=0x1A11,
            entries=("0x6041:00:16 statusword", "0x6064:00:32 position", "0x6061:00:8 mode_display", "0x603F:00:16"),
        ),
        WrittenPdo(index=0x1A02, entries=("0x0000:00:8", "0x606C:00:32 velocity", "0x6077:00:16 torque")),
    ),
)
"""Other objects in another order in other PDOs than those of the emulated drive after power-up."""


def settings_with(pdos: WrittenPdoSet, slave: int):
    """Settings in which a slave exchanges other PDOs."""
    slaves = list(SETTINGS.slaves)
    slaves[slave] = replace(slaves[slave], pdos=pdos.name)
    return replace(SETTINGS, pdo_sets=(pdos,), slaves=tuple(slaves))


def test_a_drive_exchanges_what_was_written_into_its_pdos():
    with live_ring(make_machine=Recorder) as ring, rig_of(settings_with(OWN, 0)) as rig:
        before = reading = rig.read()
        for _ in range(5):
            reading = rig.read()
            rig.write((2.0, -3.0))
        torque_1, torque_2 = ring.look().torques[-1]
        assert (torque_1, torque_2) == (pytest.approx(2.0, abs=0.02), pytest.approx(3.0, abs=0.02)), (
            "motor 2 is mirrored"
        )
        assert reading[1] - before[1] == -10 * (reading[0] - before[0]) < 0, "the sensors of the recorder count ticks"
        inputs = rig._bus.inputs(0)
        assert (inputs["mode_display"], inputs["velocity"]) == (10, 1000)


def test_it_is_written_again_after_the_other_contents():
    with live_ring(make_machine=Recorder):
        for settings in (SETTINGS, settings_with(OWN, 0), SETTINGS, settings_with(OWN, 1)):
            with rig_of(settings) as rig:
                rig.write((1.0, 1.0))
                rig.read()


@pytest.mark.parametrize(
    ("entries", "message"),
    [
        (("0x7010:11:32", "0x0000:00:16 status", "0x6010:12:32 counter"), "'boom_horizontal' must map"),
        (("0x0000:00:16 status", "0x7777:11:32 counter"), "'boom_horizontal' must map 0x7777:11:32 counter"),
    ],
)
def test_a_terminal_with_fixed_pdos_is_named(entries: tuple[str, ...], message: str):
    number = [slave.name for slave in SETTINGS.slaves].index("boom_horizontal")
    before = SETTINGS.pdo_set(SETTINGS.slaves[number])
    outputs = tuple(WrittenPdo(index=pdo.index, entries=tuple(map(str, pdo.entries))) for pdo in before.outputs)
    fixed = WrittenPdoSet(
        name="other", outputs=outputs, inputs=(WrittenPdo(index=before.inputs[0].index, entries=entries),)
    )
    with (
        live_ring(make_machine=Recorder),
        pytest.raises(RigFault, match=message),
        rig_of(settings_with(fixed, number)),
    ):
        pass


def test_a_drive_that_lacks_an_object_is_named():
    lacking = replace(OWN, inputs=(*OWN.inputs[:1], WrittenPdo(index=0x1A02, entries=("0x2205:01:16 torque",))))
    with (
        live_ring(make_machine=Recorder),
        pytest.raises(RigFault, match="'drive_1' must map"),
        rig_of(settings_with(lacking, 0)),
    ):
        pass

"""PDOs of drives and terminals by name: their sources and units are in docs/esi.md; none was tested on hardware.

Sets for drives are those of cyclic synchronous torque. Of what a drive exchanges, the rig uses the entries with a name;
it sends zero to the others, so no set has an entry where zero would be a limit, such as the largest torque or speed.
"""

from collections.abc import Mapping

from stepgap.hardware.ethercat.pdo import Entry, Pdo, PdoSet


def _pdo(index: int, *entries: str) -> Pdo:
    return Pdo(index, tuple(map(Entry.parse, entries)))


_ELMO = PdoSet(  # firmware 1.1.15 added the padding
    outputs=(
        _pdo(0x1602, "0x6071:00:16 target_torque", "0x6040:00:16 controlword"),
        _pdo(0x160B, "0x6060:00:8 mode", "0x0000:00:8"),
    ),
    inputs=(
        _pdo(
            0x1A02,
            "0x6064:00:32 position",
            "0x6077:00:16 torque",
            "0x6041:00:16 statusword",
            "0x6061:00:8 mode_display",
            "0x0000:00:8",
        ),
        _pdo(0x1A11, "0x606C:00:32 velocity"),
    ),
)

_EPOS4 = PdoSet(
    outputs=(
        _pdo(0x1602, "0x6071:00:16 target_torque", "0x60B2:00:16", "0x6040:00:16 controlword", "0x6060:00:8 mode"),
    ),
    inputs=(
        _pdo(
            0x1A02,
            "0x6041:00:16 statusword",
            "0x6077:00:16 torque",
            "0x606C:00:32 velocity",
            "0x6064:00:32 position",
            "0x6061:00:8 mode_display",
        ),
    ),
)

_SOMANET = PdoSet(
    outputs=(
        _pdo(
            0x1600,
            "0x6040:00:16 controlword",
            "0x6060:00:8 mode",
            "0x6071:00:16 target_torque",
            "0x607A:00:32",
            "0x60FF:00:32",
            "0x60B2:00:16",
            "0x2701:00:32",
        ),
        _pdo(0x1601, "0x60FE:01:32", "0x60FE:02:32"),
        _pdo(0x1602, "0x2703:00:32", "0x60B1:00:32"),
    ),
    inputs=(
        _pdo(
            0x1A00,
            "0x6041:00:16 statusword",
            "0x6061:00:8 mode_display",
            "0x6064:00:32 position",
            "0x606C:00:32 velocity",
            "0x6077:00:16 torque",
        ),
        _pdo(0x1A01, "0x2401:00:16", "0x2402:00:16", "0x2403:00:16", "0x2404:00:16", "0x2702:00:32"),
        _pdo(0x1A02, "0x60FD:00:32 digital_inputs"),
        _pdo(0x1A03, "0x2704:00:32", "0x20F0:00:32", "0x60FC:00:32", "0x606B:00:32", "0x6074:00:16"),
    ),
)

_ASDA_A2 = PdoSet(
    outputs=(_pdo(0x1603, "0x6040:00:16 controlword", "0x6071:00:16 target_torque"),),
    inputs=(
        _pdo(
            0x1A00,
            "0x6041:00:16 statusword",
            "0x6064:00:32 position",
            "0x606C:00:32 velocity",
            "0x6077:00:16 torque",
            "0x6061:00:8 mode_display",
        ),
    ),
)

_MINAS = PdoSet(
    outputs=(_pdo(0x1601, "0x6040:00:16 controlword", "0x6060:00:8 mode", "0x6071:00:16 target_torque"),),
    inputs=(
        _pdo(
            0x1A01,
            "0x603F:00:16 error_code",
            "0x6041:00:16 statusword",
            "0x6061:00:8 mode_display",
            "0x6064:00:32 position",
            "0x606C:00:32 velocity",
            "0x6077:00:16 torque",
            "0x60B9:00:16",
            "0x60BA:00:32",
            "0x60FD:00:32 digital_inputs",
        ),
    ),
)

PDO_SETS: Mapping[str, PdoSet] = {
    "none": PdoSet(),
    "elmo-cst": _ELMO,
    "maxon-epos4-cst": _EPOS4,
    "synapticon-somanet-cst": _SOMANET,
    "delta-asda-a2-cst": _ASDA_A2,
    "panasonic-minas-cst": _MINAS,
    # Control bits, which the rig does not use, are combined as padding.
    "beckhoff-el5101": PdoSet(
        outputs=(_pdo(0x1603, "0x0000:00:16", "0x7010:11:32"),),
        inputs=(_pdo(0x1A04, "0x0000:00:16 status", "0x6010:11:32 counter", "0x6010:12:32"),),
    ),
    "beckhoff-el5151": PdoSet(
        outputs=(_pdo(0x1600, "0x0000:00:16", "0x7000:11:32"),),
        inputs=(_pdo(0x1A00, "0x0000:00:16 status", "0x6000:11:32 counter", "0x6000:12:32"),),
    ),
    "analog-input": PdoSet(inputs=(_pdo(0x1A00, "0x0000:00:16 status", "0x6000:11:16 force"),)),
}
"""Predefined sets by their name in `rig.toml`, which may describe others."""

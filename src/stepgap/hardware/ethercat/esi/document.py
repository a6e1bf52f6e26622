"""What an ESI file says of its devices, as far as `rig.toml` depends on it (ETG.2000)."""

from dataclasses import dataclass


@dataclass(frozen=True)
class EsiEntry:
    """An object in a PDO.

    Attributes:
        index: Its index; 0 for padding.
        subindex: Its subindex.
        bits: Its size.
        name: Its name.
        is_real: Whether it is a number with a fraction (REAL, LREAL), which the rig neither reads nor writes.
    """

    index: int
    subindex: int
    bits: int
    name: str = ""
    is_real: bool = False


@dataclass(frozen=True)
class EsiPdo:
    """A PDO.

    Attributes:
        index: Its index.
        name: Its name.
        entries: Its contents.
        fixed: Whether the contents cannot be changed.
        mandatory: Whether it must be exchanged.
        sync_manager: Sync manager that exchanges it after power-up; None if it is not exchanged then.
        excludes: PDOs with which it cannot be exchanged.
        excluded_managers: Sync managers that cannot exchange it.
    """

    index: int
    name: str = ""
    entries: tuple[EsiEntry, ...] = ()
    fixed: bool = False
    mandatory: bool = False
    sync_manager: int | None = None
    excludes: frozenset[int] = frozenset()
    excluded_managers: frozenset[int] = frozenset()

    @property
    def bits(self) -> int:
        """Its size."""
        return sum(entry.bits for entry in self.entries)


@dataclass(frozen=True)
class InitCommand:
    """An object that a master writes by SDO when it changes the state of the device.

    Attributes:
        transitions: Changes of the state, such as PS for PREOP to SAFEOP.
        index: Index of the object.
        subindex: Its subindex.
        data: Its bytes; None if the file gives a text or something else.
        fixed: Whether a master may neither omit nor change it.
        complete_access: Whether all subindices are written at once.
        comment: What it is for.
    """

    transitions: tuple[str, ...]
    index: int
    subindex: int
    data: bytes | None
    fixed: bool = False
    complete_access: bool = False
    comment: str = ""


@dataclass(frozen=True)
class OpMode:
    """A way of synchronisation.

    Attributes:
        name: Its name, with its description.
        assign_activate: *AssignActivate*: which signals of distributed clocks it needs, 0 for none.
        cycle: Time of a cycle that the file prescribes [ns]; 0 if it is the master's.
    """

    name: str
    assign_activate: int
    cycle: int = 0


@dataclass(frozen=True)
class EsiModule:
    """A module that may be in a slot of a device.

    Attributes:
        name: Its name.
        outputs: Its PDOs from the master.
        inputs: Its PDOs to the master.
        init_commands: Objects that a master writes.
    """

    name: str
    outputs: tuple[EsiPdo, ...]
    inputs: tuple[EsiPdo, ...]
    init_commands: tuple[InitCommand, ...]


@dataclass(frozen=True)
class EsiDevice:
    """A device.

    Attributes:
        kind: Its type.
        name: Its name.
        product: Product code.
        revision: Revision number.
        outputs: PDOs from the master.
        inputs: PDOs to the master.
        has_coe: Whether it has objects that are read and written by SDO.
        pdo_assign: Whether a master may choose the PDOs (*PdoAssign*).
        pdo_config: Whether a master may write their contents (*PdoConfig*).
        init_commands: Objects that a master writes.
        op_modes: Ways of synchronisation; the first one is the default.
        control_bytes: Control byte of each sync manager; None where the file gives none.
        safeop_op_timeout: Time that it may take from SAFEOP to OP [s]; 0 if the file gives none.
        objects: Indices of all its objects; empty if the file does not describe them.
        has_slots: Whether modules determine a part of its PDOs.
    """

    kind: str
    name: str
    product: int
    revision: int
    outputs: tuple[EsiPdo, ...] = ()
    inputs: tuple[EsiPdo, ...] = ()
    has_coe: bool = False
    pdo_assign: bool = False
    pdo_config: bool = False
    init_commands: tuple[InitCommand, ...] = ()
    op_modes: tuple[OpMode, ...] = ()
    control_bytes: tuple[int | None, ...] = ()
    safeop_op_timeout: float = 0.0
    objects: frozenset[int] = frozenset()
    has_slots: bool = False


@dataclass(frozen=True)
class EsiFile:
    """An ESI file.

    Attributes:
        name: Name of the file, for messages.
        vendor: Vendor ID.
        vendor_name: Name of the vendor.
        devices: Its devices.
        modules: Modules for the slots of devices.
    """

    name: str
    vendor: int
    vendor_name: str
    devices: tuple[EsiDevice, ...]
    modules: tuple[EsiModule, ...] = ()

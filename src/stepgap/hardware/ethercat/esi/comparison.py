"""Comparison of a slave in `rig.toml` with the ESI file of its vendor."""

from collections.abc import Iterator, Sequence

from stepgap.hardware.ethercat.drive_setup import REACTIONS
from stepgap.hardware.ethercat.esi.reader import EsiDevice, EsiFile, EsiPdo, InitCommand
from stepgap.hardware.ethercat.pdo import Packing, Pdo, PdoSet
from stepgap.hardware.ethercat.rig_settings import Slave
from stepgap.hardware.ethercat.startup import LAYOUTS, is_reserved
from stepgap.rigs.rig import Finding

OUTPUT_MANAGER = 2  # Sync manager to which the rig assigns PDOs with the object 0x1C12
INPUT_MANAGER = 3  # The same for 0x1C13
_WATCHDOG_TRIGGER = 0x40  # Bit of a sync manager's control byte: its data restart the watchdog of the process data
SYNC_SIGNALS = 0x0700  # Bits of *AssignActivate* for SYNC0 and SYNC1; the rig sets no others

NEEDED_OBJECTS = {0x6072: "the largest torque", 0x6076: "the rated torque"}
"""Objects of a drive without which the rig does not connect."""

ZERO_LIMITS = frozenset({0x6072, 0x607F, 0x6080, 0x60E0, 0x60E1})
"""Limits of torque and speed with which a drive does not move if they are zero, as the rig sends what has no name."""

_CONTROLWORD = 0x6040  # Object of CiA 402 by which a drive is known

_SYNC_PARAMETERS = (0x1C32, 0x1C33)
_WRITTEN_AT = frozenset({"IP", "PS", "SO"})
_UNSIGNED = {1: "UINT8", 2: "UINT16", 4: "UINT32"}


def compare_with_esi(
    slave: Slave, pdos: PdoSet, file: EsiFile, state_timeout: float, found_revision: int | None = None
) -> list[Finding]:
    """Compares a slave with an ESI file.

    Args:
        slave: The slave as `rig.toml` describes it.
        pdos: Its PDOs.
        state_timeout: Time that the master waits for OP [s].
        found_revision: Revision number of the device on the bus; None if it is not known.
    """
    if file.vendor != slave.vendor:
        text = f"vendor = 0x{slave.vendor:08X}, but the file is that of vendor 0x{file.vendor:08X}, {file.vendor_name}"
        return [Finding(text)]
    device, findings = _device_of(slave, file, found_revision)
    if device is None:
        return findings
    return [
        *findings,
        *compare_pdos(pdos, device, file),
        *_clock_findings(slave, device),
        *_init_findings(slave, device, file),
        *_drive_findings(pdos, device, state_timeout),
    ]


def _device_of(slave: Slave, file: EsiFile, present: int | None) -> tuple[EsiDevice | None, list[Finding]]:
    """The device in the file: of the right revision, or of the nearest one, with what is doubtful about that."""
    alike = [device for device in file.devices if device.product == slave.product]
    devices = sorted(alike, key=lambda device: device.revision)
    if not devices:
        products = _listed(sorted({device.product for device in file.devices}), 8)
        return None, [Finding(f"product = 0x{slave.product:08X}, but the file describes {products or 'no device'}")]
    wanted = slave.revision or present
    revisions = _listed([device.revision for device in devices], 8)
    if not wanted:
        doubt = f"the file describes the revisions {revisions}; the last one is compared: give revision in rig.toml"
        return devices[-1], [Finding(doubt, is_error=False)] if len(devices) > 1 else []
    nearest = [device for device in devices if device.revision <= wanted][-1:] or devices[:1]
    if nearest[0].revision == wanted:
        return nearest[0], []
    if slave.revision:
        return nearest[0], [Finding(f"revision = 0x{wanted:08X}, but the file describes {revisions}")]
    doubt = f"the device has revision 0x{wanted:08X}, but the file describes {revisions}; get the file of this revision"
    return nearest[0], [Finding(doubt, is_error=False)]


# ---- PDOs


def compare_pdos(pdos: PdoSet, device: EsiDevice, file: EsiFile) -> list[Finding]:
    """Compares a set of PDOs with a device: whether they exist, may be combined, and have these contents."""
    modules = file.modules if device.has_slots else ()
    directions = (
        (pdos.outputs, device.outputs, [pdo for module in modules for pdo in module.outputs], OUTPUT_MANAGER),
        (pdos.inputs, device.inputs, [pdo for module in modules for pdo in module.inputs], INPUT_MANAGER),
    )
    findings = [
        finding
        for wanted, own, of_modules, manager in directions
        for finding in _direction_findings(wanted, own, of_modules, manager, device)
    ]
    if (pdos.outputs or pdos.inputs) and not device.has_coe:
        text = "pdos: according to the file the device has no CoE, without which PDOs cannot be checked"
        findings.append(Finding(text))
    return findings


def _direction_findings(
    wanted: tuple[Pdo, ...], own: tuple[EsiPdo, ...], of_modules: list[EsiPdo], manager: int, device: EsiDevice
) -> Iterator[Finding]:
    kind = "outputs" if manager == OUTPUT_MANAGER else "inputs"
    indices = [pdo.index for pdo in wanted]
    chosen = list[EsiPdo]()
    for pdo in wanted:
        candidates = [candidate for candidate in (*own, *of_modules) if candidate.index == pdo.index]
        if candidates:
            best = min(candidates, key=lambda candidate: bool(_difference(pdo, candidate)))
            chosen.append(best)
            yield from _content_findings(pdo, best, device.pdo_config)
        else:
            others = _listed([candidate.index for candidate in (*own, *of_modules)], 16, 4) or "none"
            yield Finding(f"pdos: there is no PDO 0x{pdo.index:04X} among the {kind}, which are {others}")
    pairs = {(pdo.index, other) for pdo in chosen for other in pdo.excludes & set(indices) - {pdo.index}}
    for first, second in sorted({(min(pair), max(pair)) for pair in pairs}):
        yield Finding(f"pdos: PDOs 0x{first:04X} and 0x{second:04X} cannot be exchanged together (Exclude)")
    for esi_pdo in chosen:
        yield from _manager_findings(esi_pdo, manager)
    for esi_pdo in own:
        if esi_pdo.mandatory and esi_pdo.index not in indices:
            yield Finding(f"pdos: PDO 0x{esi_pdo.index:04X} ({esi_pdo.name}) is mandatory among the {kind}")
    yield from _assignment_findings(indices, own, kind, device)


def _content_findings(wanted: Pdo, esi_pdo: EsiPdo, pdo_config: bool) -> Iterator[Finding]:
    difference = _difference(wanted, esi_pdo)
    reals = [entry for entry in esi_pdo.entries if entry.is_real]
    for entry in wanted.entries:
        if entry.name and any((real.index, real.subindex) == (entry.index, entry.subindex) for real in reals):
            yield Finding(f"pdos: {entry} is a REAL according to the file, and the rig has whole numbers only")
    if not difference:
        if names_no_objects(esi_pdo):
            text = f"pdos: the file does not say which objects PDO 0x{esi_pdo.index:04X} has"
            yield Finding(f"{text}; only their sizes are compared", is_error=False)
        return
    if esi_pdo.fixed or not pdo_config:
        reason = "its contents are fixed" if esi_pdo.fixed else "its contents cannot be written (PdoConfig)"
        yield Finding(f"pdos: {difference}, and {reason}")
    else:
        yield Finding(f"pdos: {difference}; the rig writes the contents of rig.toml", is_error=False)


def names_no_objects(pdo: EsiPdo) -> bool:
    """Whether a file names subindices of the mapping object instead of the mapped objects, as some files do."""
    return any(entry.index == pdo.index for entry in pdo.entries)


def _difference(wanted: Pdo, esi_pdo: EsiPdo) -> str:
    """What differs between the used values of a PDO and the file; empty if nothing does."""
    at = 0
    there = dict[int, tuple[int, int, int]]()
    for entry in esi_pdo.entries:
        there[at] = entry.index, entry.subindex, entry.bits
        at += entry.bits
    bit = 0
    for entry in wanted.entries:
        other = there.get(bit)
        unknown = other is not None and other[0] == esi_pdo.index and other[2] == entry.bits
        if entry.name and entry.index and not unknown and other != (entry.index, entry.subindex, entry.bits):
            text = "0x{:04X}:{:02X}:{}".format(*other) if other else "no entry"
            return f"PDO 0x{wanted.index:04X} has {entry} at bit {bit}, but {text} according to the file"
        bit += entry.bits
    return "" if bit == at else f"PDO 0x{wanted.index:04X} has {bit} bits, but {at} according to the file"


def _manager_findings(pdo: EsiPdo, manager: int) -> Iterator[Finding]:
    assigned = pdo.sync_manager
    if (assigned is not None and assigned != manager) or manager in pdo.excluded_managers:
        conflict = "cannot be in" if assigned in (None, manager) else f"is in sync manager {assigned}, not in"
        yield Finding(f"pdos: PDO 0x{pdo.index:04X} {conflict} sync manager {manager}, to which the rig assigns it")


def _assignment_findings(
    indices: list[int], own: tuple[EsiPdo, ...], kind: str, device: EsiDevice
) -> Iterator[Finding]:
    """Compares with the PDOs that are exchanged after power-up, where nobody changes them."""
    default = [pdo.index for pdo in own if pdo.sync_manager is not None and pdo.entries]
    listed = _listed(default, 16, 4) or "none"
    if not indices and default:
        yield Finding(f"pdos: there are no {kind}, but the device exchanges {listed} unless a master changes this")
    elif indices and indices != default and not device.pdo_assign and not device.has_slots:
        reason = "the assignment cannot be changed (PdoAssign)"
        yield Finding(
            f"pdos: the {kind} are {_listed(indices, 16, 4)}, but {listed} according to the file, and {reason}"
        )


# ---- distributed clocks


def _clock_findings(slave: Slave, device: EsiDevice) -> Iterator[Finding]:
    wanted = slave.assign_activate
    modes = device.op_modes
    listed = ", ".join(f"{mode.name} 0x{mode.assign_activate:04X}" for mode in modes)
    if not modes:
        if wanted:
            yield Finding(f"assign_activate = 0x{wanted:04X}, but the file describes no distributed clocks")
        return
    same = [mode for mode in modes if mode.assign_activate & SYNC_SIGNALS == wanted & SYNC_SIGNALS]
    if not same:
        yield Finding(f"assign_activate = 0x{wanted:04X}, but the OpModes of the file are {listed}")
    elif all(mode.assign_activate != wanted for mode in same):
        text = f"the file has AssignActivate 0x{same[0].assign_activate:04X}; the rig sets 0x{wanted:04X} of it"
        yield Finding(text, is_error=False)
    elif same[0] is not modes[0]:
        text = f"assign_activate = 0x{wanted:04X}, which is {same[0].name}; the default of the file is {modes[0].name}"
        yield Finding(f"{text}, 0x{modes[0].assign_activate:04X}", is_error=False)
    if wanted and same and same[0].cycle:
        text = f"the file prescribes a cycle of {same[0].cycle} ns for {same[0].name}; compare it with tick"
        yield Finding(text, is_error=False)


# ---- start-up


def startup_text(command: InitCommand) -> str:
    """An object of `startup` that writes the same bytes; empty if `startup` cannot have it."""
    data = command.data
    if data is None or len(data) not in _UNSIGNED or command.complete_access or is_reserved(command.index):
        return ""
    value = int.from_bytes(data, "little")
    return f"0x{command.index:04X}:{command.subindex:02X} {_UNSIGNED[len(data)]} = {value}"


def startup_commands(device: EsiDevice) -> list[InitCommand]:
    """What the device demands on the way to OP, without what the rig sets itself.

    It sets the objects of other keys of `rig.toml`, and the option codes of a drive, so that torque goes off.
    """
    is_drive = any(entry.index == _CONTROLWORD for pdo in device.outputs for entry in pdo.entries)
    reactions = {reaction.index for reaction in REACTIONS} if is_drive else set()
    return [
        command
        for command in device.init_commands
        if _WRITTEN_AT & set(command.transitions)
        and command.index not in reactions
        and (command.index in _SYNC_PARAMETERS or not is_reserved(command.index))
    ]


def _init_findings(slave: Slave, device: EsiDevice, file: EsiFile) -> Iterator[Finding]:
    present = {(startup.index, startup.subindex): startup for startup in slave.startup_objects}
    for command in startup_commands(device):
        address = f"0x{command.index:04X}:{command.subindex:02X}"
        comment = f" ({command.comment})" if command.comment else ""
        text = startup_text(command)
        own = present.get((command.index, command.subindex))
        if own is not None:
            bytes_of = LAYOUTS[own.kind].pack(own.value)
            if command.data is not None and bytes_of != command.data:
                written = f"startup has '{own}', but the file writes {command.data.hex()} to {address}{comment}"
                yield Finding(written, is_error=command.fixed)
        elif text:
            yield Finding(f'startup: the file writes {address}{comment}, which is missing; add "{text}"')
        else:
            data = command.data.hex() if command.data else "a text"
            yield Finding(f"the file writes {data} to {address}{comment}, which startup cannot do", is_error=False)
    if device.has_slots and any(module.init_commands for module in file.modules):
        text = "modules of the file have start-up objects of their own; compare them with startup"
        yield Finding(text, is_error=False)


# ---- facts about drives


def _drive_findings(pdos: PdoSet, device: EsiDevice, state_timeout: float) -> Iterator[Finding]:
    if device.safeop_op_timeout > state_timeout:
        text = f"the device may take {device.safeop_op_timeout:g} s to reach OP; the rig waits for {state_timeout:g} s"
        yield Finding(text, is_error=False)
    if "controlword" not in Packing(pdos.outputs).names:
        return
    sent = {entry.index for pdo in pdos.outputs for entry in pdo.entries}
    for index in sorted(sent & ZERO_LIMITS):
        text = f"pdos: the rig sends zero to 0x{index:04X} among the outputs, with which a drive does not move"
        yield Finding(text, is_error=False)
    control = device.control_bytes[OUTPUT_MANAGER] if len(device.control_bytes) > OUTPUT_MANAGER else None
    if control is not None and not control & _WATCHDOG_TRIGGER:
        text = f"the control byte 0x{control:02X} of the outputs enables no watchdog"
        yield Finding(f"{text}; the proof of the watchdog on the drive counts", is_error=False)
    if not device.objects:
        return
    for index, what in NEEDED_OBJECTS.items():
        if index not in device.objects:
            yield Finding(f"the file lists no object 0x{index:04X}, {what}, which the rig needs", is_error=False)
    unlisted = [reaction for reaction in REACTIONS if reaction.index not in device.objects]
    lacking = [f"0x{reaction.index:04X} ({reaction.name})" for reaction in unlisted]
    if lacking:
        text = f"the file lists no option code {', '.join(lacking)}: read in the manual what the drive does"
        yield Finding(text, is_error=False)


def _listed(numbers: Sequence[int], most: int, digits: int = 8) -> str:
    """Numbers in hexadecimal; the first ones of many."""
    shown = ", ".join(f"0x{number:0{digits}X}" for number in numbers[:most])
    return f"{shown}, …" if len(numbers) > most else shown

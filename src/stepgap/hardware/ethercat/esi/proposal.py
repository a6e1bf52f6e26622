"""Text for a `rig.toml` from an ESI file: a start for a device that is new to its user."""

import re
from collections.abc import Callable, Iterator, Sequence
from itertools import combinations

from stepgap.base.errors import InputError
from stepgap.base.settings_file import toml_string
from stepgap.hardware.ethercat.distributed_clocks import SYNC0_AND_SYNC1, SYNC0_ONLY
from stepgap.hardware.ethercat.esi.comparison import (
    SYNC_SIGNALS,
    ZERO_LIMITS,
    compare_pdos,
    names_no_objects,
    startup_commands,
    startup_text,
)
from stepgap.hardware.ethercat.esi.reader import EsiDevice, EsiFile, EsiPdo, parse_number, shorten
from stepgap.hardware.ethercat.pdo import ENTRY_FORMATS, Entry, Pdo, PdoSet
from stepgap.hardware.ethercat.pdo_sets import PDO_SETS

MOST_DEVICES = 20  # Largest number of devices that are described; of more, only a list is given

VALUES = {
    0x603F: "error_code",
    0x6040: "controlword",
    0x6041: "statusword",
    0x6060: "mode",
    0x6061: "mode_display",
    0x6064: "position",
    0x606C: "velocity",
    0x6071: "target_torque",
    0x6077: "torque",
    0x60FD: "digital_inputs",
}
"""What an object of CiA 402 is to the rig."""

OTHER_TARGETS = frozenset({0x607A, 0x60FF, 0x6042})
"""Targets of position and velocity, which a set for torque does without if possible."""

_MOST_SEARCHED = 24
_MOST_COMBINED = 3
_LARGEST_ENTRY = 64


def propose(file: EsiFile, product: str | None = None) -> str:
    """Describes the devices of an ESI file, or the one with a product code, as text for a `rig.toml`.

    Raises:
        InputError: The file has no such device.
    """
    devices = _latest(file, product)
    title = f"# {shorten(file.name)}: {len(devices)} device(s) of vendor 0x{file.vendor:08X}, {file.vendor_name}"
    if len(devices) > MOST_DEVICES:
        rows = [f"#   --product 0x{device.product:08X}  {device.kind}, {device.name}" for device in devices]
        return "\n".join([title, "# Give one of them:", *rows])
    parts = [line for device in devices for line in ("", *_device_lines(file, device))]
    return "\n".join([title, "# Compare every line with the manual of the device before you use it.", *parts])


def _latest(file: EsiFile, product: str | None) -> list[EsiDevice]:
    """The last revision of each device, or of the one that is asked for."""
    latest: dict[int, EsiDevice] = {}
    for device in sorted(file.devices, key=lambda device: device.revision):
        latest[device.product] = device
    if not latest:
        raise InputError(f"{file.name}: describes no device, only modules of devices; give the file of the device")
    if product is None:
        return [latest[number] for number in dict.fromkeys(device.product for device in file.devices)]
    try:
        return [latest[parse_number(product)]]
    except (KeyError, ValueError):
        products = ", ".join(f"0x{number:08X}" for number in list(latest)[:8])
        raise InputError(f"--product {product}: {file.name} has {products}{', …' if len(latest) > 8 else ''}") from None


def _device_lines(file: EsiFile, device: EsiDevice) -> Iterator[str]:
    sets = _named_sets(device, file)
    revisions = sorted({other.revision for other in file.devices if other.product == device.product})
    yield f"# {device.kind}: {device.name}"
    yield "[[slaves]]"
    yield f"name = {toml_string(device.kind or device.name or 'device')}"
    yield f"vendor = 0x{file.vendor:08X}"
    yield f"product = 0x{device.product:08X}"
    others = f"; the file has {len(revisions)} revisions" if len(revisions) > 1 else ""
    yield f"revision = 0x{device.revision:08X} # remove this line if every revision is right{others}"
    yield f"esi = {toml_string(file.name)} # in the folder of rig.toml"
    yield f'pdos = "{next(iter(sets), "none")}"'
    fitting = [name for name, pdos in PDO_SETS.items() if pdos.inputs and not compare_pdos(pdos, device, file)]
    if fitting:
        yield f"# These sets of StepGap fit, too: {', '.join(fitting)}"
    yield from _clock_lines(device)
    yield from _startup_lines(device)
    for name, pdos in sets.items():
        yield from _set_lines(name, *pdos)
    yield from _other_lines(file, device, sets)


def _clock_lines(device: EsiDevice) -> Iterator[str]:
    if not device.op_modes:
        return
    default = device.op_modes[0]
    supported = (0, SYNC0_ONLY, SYNC0_AND_SYNC1)
    listed = ", ".join(f"0x{mode.assign_activate:04X} {mode.name}" for mode in device.op_modes)
    value = default.assign_activate & SYNC_SIGNALS
    yield f"assign_activate = 0x{value if value in supported else 0:04X} # the file has {listed}"


def _startup_lines(device: EsiDevice) -> Iterator[str]:
    commands = startup_commands(device)
    written = [command for command in commands if startup_text(command)]
    texts = {(command.index, command.subindex): (startup_text(command), command.comment) for command in written}
    if texts:
        yield "startup = ["
        for text, comment in texts.values():
            yield f"    {toml_string(text)}," + (f" # {comment}" if comment else "")
        yield "]"
    for command in commands:
        if not startup_text(command):
            data = command.data.hex() if command.data else "a text"
            yield f"# startup cannot write 0x{command.index:04X}:{command.subindex:02X} = {data} ({command.comment})"


# ---- sets of PDOs

_Chosen = tuple[tuple[EsiPdo, ...], tuple[EsiPdo, ...]]


def _named_sets(device: EsiDevice, file: EsiFile) -> dict[str, _Chosen]:
    """Sets that the rig can exchange: one for torque, if the device is a drive, and that after power-up."""
    name = re.sub(r"[^a-z0-9]+", "-", (device.kind or device.name or "device").lower()).strip("-") or "device"
    torque = _for_torque(device)
    default = _after_power_up(device)
    sets: dict[str, _Chosen] = {}
    if torque:
        sets[f"{name}-torque"] = torque
    if any(default) and default != torque:
        sets[f"{name}-default"] = default
    return {set_name: pdos for set_name, pdos in sets.items() if not _obstacle(pdos, device, file)}


def _after_power_up(device: EsiDevice) -> _Chosen:
    """The PDOs that the device exchanges unless a master changes this."""
    outputs = tuple(pdo for pdo in device.outputs if pdo.sync_manager is not None)
    return outputs, tuple(pdo for pdo in device.inputs if pdo.sync_manager is not None)


def _for_torque(device: EsiDevice) -> _Chosen | None:
    """PDOs with which the rig can control the torque of a drive; None if the file has none."""
    outputs = _combination(device.outputs, {0x6040, 0x6071}, _output_costs)
    inputs = _combination(device.inputs, {0x6041, 0x6064}, _input_costs)
    return (outputs, inputs) if outputs and inputs else None


def _combination(
    pdos: Sequence[EsiPdo], needed: set[int], costs: Callable[[frozenset[int]], int]
) -> tuple[EsiPdo, ...] | None:
    """The best combination that has the needed objects: least costs, then fewest PDOs, then fewest bits."""
    mandatory = [pdo for pdo in pdos if pdo.mandatory]
    optional = [pdo for pdo in pdos if not pdo.mandatory][:_MOST_SEARCHED]
    candidates = []
    for count in range(_MOST_COMBINED + 1):
        for added in combinations(optional, count):
            # All mandatory PDOs and a few others count, if they have what is needed and none excludes another.
            chosen = tuple(sorted((*mandatory, *added), key=lambda pdo: pdo.index))
            objects = frozenset(entry.index for pdo in chosen for entry in pdo.entries if not entry.is_real)
            together = {pdo.index for pdo in chosen}
            if needed <= objects and not any(pdo.excludes & (together - {pdo.index}) for pdo in chosen):
                candidates.append((costs(objects), len(chosen), sum(pdo.bits for pdo in chosen), chosen))
    return min(candidates, key=lambda candidate: candidate[:3])[3] if candidates else None


def _output_costs(objects: frozenset[int]) -> int:
    return 100 * len(objects & ZERO_LIMITS) + 10 * len(objects & OTHER_TARGETS) + (0x6060 not in objects)


def _input_costs(objects: frozenset[int]) -> int:
    return len({0x6061, 0x606C, 0x6077} - objects)


def _obstacle(pdos: _Chosen, device: EsiDevice, file: EsiFile) -> str:
    """Why the rig cannot exchange these PDOs; empty if it can."""
    outside = [pdo for direction in pdos for pdo in direction if not 0x1600 <= pdo.index <= 0x1BFF]
    if outside:
        return f"0x{outside[0].index:04X} is no index of a PDO from 0x1600 to 0x1BFF"
    try:
        converted = PdoSet(*_converted(pdos))
    except ValueError as error:
        return str(error)
    return "; ".join(finding.text for finding in compare_pdos(converted, device, file) if finding.is_error)


def _converted(chosen: _Chosen) -> tuple[tuple[Pdo, ...], tuple[Pdo, ...]]:
    """The same PDOs, with names for what the rig uses; the second of two equal values has none."""
    named: set[str] = set()
    directions = []
    for pdos in chosen:
        converted = []
        bit = 0
        for pdo in pdos:
            entries = []
            for entry in pdo.entries:
                # The rig reads a value once, in whole bytes, and no fractions.
                name = VALUES.get(entry.index, "") if entry.subindex == 0 and bit % 8 == 0 else ""
                if entry.bits not in ENTRY_FORMATS or name in named or entry.is_real:
                    name = ""
                named |= {name} - {""}
                if entry.bits > _LARGEST_ENTRY or entry.index > 0xFFFF or entry.subindex > 0xFF:
                    raise ValueError(f"PDO 0x{pdo.index:04X} has an entry that rig.toml cannot have")
                entries.append(Entry(entry.index, entry.subindex, entry.bits, name))
                bit += entry.bits
            converted.append(Pdo(pdo.index, tuple(entries)))
        directions.append(tuple(converted))
    return directions[0], directions[1]


def _set_lines(name: str, outputs: tuple[EsiPdo, ...], inputs: tuple[EsiPdo, ...]) -> Iterator[str]:
    yield ""
    yield "[[pdo_sets]]"
    yield f'name = "{name}"'
    for kind, pdos, converted in zip(
        ("outputs", "inputs"), (outputs, inputs), _converted((outputs, inputs)), strict=True
    ):
        for pdo, own in zip(pdos, converted, strict=True):
            yield f"[[pdo_sets.{kind}]]" + (f" # {pdo.name}" if pdo.name else "")
            yield f"index = 0x{pdo.index:04X}"
            yield "entries = ["
            for entry, described in zip(own.entries, pdo.entries, strict=True):
                comment = f"{described.name} (REAL, not used by the rig)" if described.is_real else described.name
                yield f'    "{entry}",' + (f" # {comment}" if comment and not entry.name else "")
            yield "]"
    if any(map(names_no_objects, (*outputs, *inputs))):
        yield "# The file does not say which objects these are: write those of the manual, with their names."
    limits = sorted({entry.index for pdo in outputs for entry in pdo.entries} & ZERO_LIMITS)
    if limits:
        listed = ", ".join(f"0x{index:04X}" for index in limits)
        yield f"# Take {listed} out of the outputs: the rig would send zero, with which the drive does not move."


def _other_lines(file: EsiFile, device: EsiDevice, sets: dict[str, _Chosen]) -> Iterator[str]:
    """The PDOs that are in no set, and what else a user must know."""
    used = {pdo.index for pdos in sets.values() for direction in pdos for pdo in direction}
    others = [pdo for pdo in (*device.outputs, *device.inputs) if pdo.index not in used]
    if obstacle := _obstacle(_after_power_up(device), device, file):
        yield ""
        yield f"# The rig cannot exchange the PDOs after power-up: {obstacle}"
    if others:
        yield ""
        yield "# Other PDOs of the device:"
    for pdo in others:
        entries = " ".join(f"0x{entry.index:04X}:{entry.subindex:02X}:{entry.bits}" for entry in pdo.entries)
        excludes = ", ".join(f"0x{index:04X}" for index in sorted(pdo.excludes))
        yield f"#   0x{pdo.index:04X} {pdo.name}: {entries}" + (f"; not with {excludes}" if excludes else "")
    if device.pdo_config and any(not pdo.fixed for pdo in (*device.outputs, *device.inputs)):
        yield "# The contents of PDOs that are not fixed may be others (PdoConfig): the rig writes those of rig.toml."
    if device.has_slots:
        names = ", ".join(module.name for module in file.modules[:8]) or "in other files"
        yield f"# The device has slots, whose modules have PDOs of their own: {names}"

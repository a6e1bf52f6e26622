"""Registers of a slave controller: addresses, states and codes (ETG.1000.4 §6, ETG.1000.6 §6.4)."""

from enum import IntEnum

TYPE, FMMU_COUNT, ESC_FEATURES = 0x0000, 0x0004, 0x0008
"""Type of the slave controller, numbers of its parts from 0x0004 on, and features (§6.1.1)."""

STATION_ADDRESS = 0x0010
DL_CONTROL, DL_STATUS = 0x0100, 0x0110
"""Data link: DL_STATUS contains which ports are linked, open or looped back, and so the topology (§6.1.4)."""

AL_CONTROL, AL_STATUS, AL_STATUS_CODE = 0x0120, 0x0130, 0x0134
"""Application layer: requested state, present state, reason of a refusal (ETG.1000.6 §5.3)."""

PDI_CONTROL = 0x0140
INTERRUPT_MASK = 0x0200
ERROR_COUNTERS = 0x0300

WATCHDOG_DIVIDER, WATCHDOG_TIME, WATCHDOG_STATUS, WATCHDOG_COUNTER = 0x0400, 0x0420, 0x0440, 0x0442
"""Watchdog of process data: its time has the unit (divider + 2) · 40 ns; status bit 0 is 0 once it expired (§6.3)."""

PDI_WATCHDOG_TIME = 0x0410
EEPROM_CONFIGURATION, EEPROM_CONTROL, EEPROM_ADDRESS, EEPROM_DATA = 0x0500, 0x0502, 0x0504, 0x0508
"""Slave information interface (§6.4): write address and command, read the data."""

EEPROM_READ, EEPROM_COMMANDS, EEPROM_COMMAND_ERROR, EEPROM_READS_8_BYTES = 0x0100, 0x0700, 0x2000, 0x0040
"""The command that reads, all commands; bits of the state: the command was refused, a read gives 8 bytes."""

FMMU, FMMU_SIZE, FMMU_SLOTS = 0x0600, 16, 4  # Fieldbus memory management units (§6.6): logical address → memory

SYNC_MANAGER, SYNC_MANAGER_SIZE, SYNC_MANAGER_SLOTS = 0x0800, 8, 4
"""Sync managers (§6.7): 0 mailbox in, 1 mailbox out, 2 outputs, 3 inputs."""

MAILBOX_FULL, SYNC_MANAGER_ENABLED, WATCHDOG_TRIGGER, REPEAT = 0x08, 0x01, 0x40, 0x02
"""Bits of a sync manager's status, activation, control, and again activation and its echo."""

DC_RECEIVE_TIME = 0x0900
DC_SYSTEM_TIME = 0x0910
DC_RECEIVE_TIME_UNIT = 0x0918
DC_OFFSET = 0x0920
DC_DELAY = 0x0928
DC_DIFFERENCE = 0x092C
DC_SPEED_COUNTER = 0x0930
DC_ACTIVATION, DC_START, DC_CYCLE_0, DC_END = 0x0981, 0x0990, 0x09A0, 0x09A8
"""Distributed clocks (§6.8): receive times of the ports, system time, its parts and their control; then SYNC0."""

DC_SYNC0_ACTIVE = 0x03  # Bits of the activation: cyclic operation and SYNC0

PROCESS_RAM = 0x1000
MEMORY_SIZE = 0x2000

WRITABLE = (
    (STATION_ADDRESS, STATION_ADDRESS + 2),
    (DL_CONTROL, DL_CONTROL + 4),
    (AL_CONTROL, AL_CONTROL + 2),
    (INTERRUPT_MASK, INTERRUPT_MASK + 8),
    (ERROR_COUNTERS, ERROR_COUNTERS + 20),
    (WATCHDOG_DIVIDER, WATCHDOG_DIVIDER + 2),
    (PDI_WATCHDOG_TIME, PDI_WATCHDOG_TIME + 2),
    (WATCHDOG_TIME, WATCHDOG_TIME + 2),
    (WATCHDOG_COUNTER, WATCHDOG_COUNTER + 2),
    (EEPROM_CONFIGURATION, EEPROM_DATA),
    (FMMU, FMMU + FMMU_SLOTS * FMMU_SIZE),
    (SYNC_MANAGER, SYNC_MANAGER + SYNC_MANAGER_SLOTS * SYNC_MANAGER_SIZE),
    (DC_OFFSET, DC_DIFFERENCE),
    (DC_SPEED_COUNTER, DC_END),
    (PROCESS_RAM, MEMORY_SIZE),
)
"""Ranges [from, to) that a master may write; other bytes do not change."""


class AlState(IntEnum):
    """States of the application layer (ETG.1000.6 §6.4.1)."""

    INIT = 1
    PREOP = 2
    SAFEOP = 4
    OP = 8


BOOTSTRAP = 3  # State in which firmware is loaded; none of the slaves has it

ERROR_FLAG = ACKNOWLEDGE = 0x10
"""Bit of AL_STATUS: the last change was refused or a state was lost; bit of AL_CONTROL: the master acknowledges it."""


class StatusCode(IntEnum):
    """Why a state was refused or lost (ETG.1000.6, AL status codes)."""

    NONE = 0x0000
    INVALID_CHANGE = 0x0011
    UNKNOWN_STATE = 0x0012
    NO_BOOTSTRAP = 0x0013
    INVALID_MAILBOX = 0x0016
    SYNCHRONISATION = 0x001A
    WATCHDOG = 0x001B
    INVALID_OUTPUTS = 0x001D
    INVALID_INPUTS = 0x001E
    NO_SYNC = 0x002D
    INVALID_SYNC = 0x0030

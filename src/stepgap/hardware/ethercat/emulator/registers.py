"""Registers of a slave controller: addresses, states and codes (ETG.1000.4 §6, ETG.1000.6 §6.4)."""

from enum import IntEnum

# Type of the slave controller, numbers of its parts from 0x0004 on, and features (§6.1.1).
TYPE = 0x0000
FMMU_COUNT = 0x0004
ESC_FEATURES = 0x0008

# Data link: DL_STATUS contains which ports are linked, open or looped back, and so the topology (§6.1.4).
STATION_ADDRESS = 0x0010
DL_CONTROL = 0x0100
DL_STATUS = 0x0110

# Application layer: requested state, present state, reason of a refusal (ETG.1000.6 §5.3).
AL_CONTROL = 0x0120
AL_STATUS = 0x0130
AL_STATUS_CODE = 0x0134

PDI_CONTROL = 0x0140
INTERRUPT_MASK = 0x0200
ERROR_COUNTERS = 0x0300

# Watchdog of process data: its time has the unit (divider + 2) · 40 ns; status bit 0 is 0 once it expired (§6.3).
WATCHDOG_DIVIDER = 0x0400
PDI_WATCHDOG_TIME = 0x0410
WATCHDOG_TIME = 0x0420
WATCHDOG_STATUS = 0x0440
WATCHDOG_COUNTER = 0x0442

# Slave information interface (§6.4): write address and command, read the data.
EEPROM_CONFIGURATION = 0x0500
EEPROM_CONTROL = 0x0502
EEPROM_ADDRESS = 0x0504
EEPROM_DATA = 0x0508

# Its command that reads, and all commands; bits of its state: the command was refused, a read gives 8 bytes.
EEPROM_READ = 0x0100
EEPROM_COMMANDS = 0x0700
EEPROM_COMMAND_ERROR = 0x2000
EEPROM_READS_8_BYTES = 0x0040

# Fieldbus memory management units (§6.6): logical address → memory.
FMMU = 0x0600
FMMU_SIZE = 16
FMMU_SLOTS = 4

# Sync managers (§6.7): 0 mailbox in, 1 mailbox out, 2 outputs, 3 inputs.
SYNC_MANAGER = 0x0800
SYNC_MANAGER_SIZE = 8
SYNC_MANAGER_SLOTS = 4

# Bits of a sync manager's status, activation, control, and again activation and its echo.
MAILBOX_FULL = 0x08
SYNC_MANAGER_ENABLED = 0x01
WATCHDOG_TRIGGER = 0x40
REPEAT = 0x02

# Distributed clocks (§6.8): receive times of the ports, system time, its parts and their control; then SYNC0.
DC_RECEIVE_TIME = 0x0900
DC_SYSTEM_TIME = 0x0910
DC_RECEIVE_TIME_UNIT = 0x0918
DC_OFFSET = 0x0920
DC_DELAY = 0x0928
DC_DIFFERENCE = 0x092C
DC_SPEED_COUNTER = 0x0930
DC_ACTIVATION = 0x0981
DC_START = 0x0990
DC_CYCLE_0 = 0x09A0
DC_END = 0x09A8
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

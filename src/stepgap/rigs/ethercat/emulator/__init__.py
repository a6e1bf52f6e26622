"""An emulated EtherCAT ring: two CiA 402 drives, a coupler and terminals in software, a machine behind them.

Read in this order: `frame` (Ethernet frames and datagrams), `registers` (of a slave controller), `sii` (its EEPROM),
`dictionary` and `mailbox` (CANopen over EtherCAT), `slave` (the slave controller), `drive` and `terminals` (what sits
behind it), `machine` (what the drives move), `faults` (scripted disturbances), `ring` (frame in, frames out), `network`
(a veth pair to speak over), `emulator` (all together, as a thread or a process).

The standards cited: ETG.1000.4 (data link layer), ETG.1000.6 (application layer), ETG.2010 (EEPROM), ETG.1020 (protocol
enhancements), CiA 402-2 (IEC 61800-7-201, drive profile) and ETG.6010 (how drives do it on EtherCAT). What is behind
the emulation is enough for SOEM and its like; it has never been compared with a real slave controller.
"""

"""An emulated EtherCAT ring: two CiA 402 drives, a coupler and terminals in software, connected to a machine.

Read in this order: `frame` (Ethernet frames and datagrams), `registers` (of a slave controller), `sii` (its EEPROM),
`dictionary` and `mailbox` (CANopen over EtherCAT), `clock` (distributed clocks), `slave` (the slave controller),
`device` (the application of a slave), `drive`, `terminals`, `faults` (scripted disturbances), `ring` (frame in, frames
out, and the machine that the drives move), `network` (a veth pair), `emulator` (the ring on a network interface, in
this process or another).

The standards cited: ETG.1000.4 (data link layer), ETG.1000.6 (application layer), ETG.2010 (EEPROM), ETG.1020 (protocol
enhancements), CiA 402-2 (IEC 61800-7-201, drive profile) and ETG.6010 (the drive profile on EtherCAT). The ring does
what SOEM needs; it has not been compared with a real slave controller. `docs/emulated_ring.md` lists what is missing.
"""

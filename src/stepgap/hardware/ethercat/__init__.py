"""The robot on an EtherCAT ring: torque-controlled drives and boom encoders.

Read in this order: `cia402` (power states of drives), `pdo` (layout of the process data), `rig_settings` (`rig.toml`),
`bus` (the master), `ethercat_rig` (the `Rig`); `emulator` emulates the slaves.
"""

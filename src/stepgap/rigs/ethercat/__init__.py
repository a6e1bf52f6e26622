"""Drives and encoders on an EtherCAT bus: `cia402`, `pdo`, `rig_settings`, `ethercat_rig`."""

"""The robot on two mjbots moteus controllers: joint commands over CAN-FD, boom and foot at their auxiliary ports.

Read in this order: `moteus_settings` (`moteus.toml`, torques of a controller), `can_bus` (frames and their
replies with a timeout), `watchdog` (its proof), `moteus_rig` (the `Rig`).
"""

"""The robot on two mjbots moteus controllers: joint commands over CAN-FD, boom and foot at their auxiliary ports.

Read in this order: `joint` (commands and states of a joint), `moteus_settings` (`moteus.toml`), `can_bus` (frames and
their replies with a timeout), `moteus_rig` (the `Rig`).
"""

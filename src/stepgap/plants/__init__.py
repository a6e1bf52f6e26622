"""Plants, which execute steps.

The model itself (`ModelPlant`), the 1 kHz loop on a rig (`RigPlant`, `RealtimePlant`), or another program
(`ProcessPlant`).
"""

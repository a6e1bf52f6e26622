"""Plants, which execute steps: the model itself (`ModelPlant`) the 1 kHz loop on a rig
(`RigPlant`, `RealtimePlant`), or another program (`ProcessPlant`).
"""

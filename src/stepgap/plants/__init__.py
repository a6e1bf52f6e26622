"""Plants, which execute steps: the model itself (`ModelPlant`) or the 1 kHz loop on a rig (`RigPlant`)."""

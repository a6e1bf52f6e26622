"""What executes a step: the model itself (`ModelPlant`) or the 1 kHz loop on a rig (`RigPlant`)."""

"""The verbs of hardware: `stepgap rig …`."""

"""The verb of sweeps: `stepgap sweep`, with the options for many cases."""

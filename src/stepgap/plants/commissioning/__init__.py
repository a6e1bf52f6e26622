"""What `stepgap rig` does: `emulate` a ring, `check` machine and bus, `calibrate` the zeros, and a `dry_run`."""

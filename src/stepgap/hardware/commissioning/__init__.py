"""Commissioning of a robot for `stepgap rig`: the `check` of computer and bus, and the `dry_run` without torque."""

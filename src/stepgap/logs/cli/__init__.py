"""The verbs of logs: `stepgap steps` and `stepgap fit`."""

"""The verbs `stepgap report`, `stepgap check` and `stepgap gait`."""

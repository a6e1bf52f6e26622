"""The verbs `stepgap explain` and `stepgap compare`."""

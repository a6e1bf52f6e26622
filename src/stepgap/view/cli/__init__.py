"""The verb `stepgap view`."""

"""The verb of exports: `stepgap export`."""

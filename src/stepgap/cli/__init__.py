"""The command line: one file per verb; the only place that chooses robots and plants."""

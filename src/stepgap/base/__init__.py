"""What every folder stands on: whole files, settings files, signals, random streams, compiled code."""

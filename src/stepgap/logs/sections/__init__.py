"""Steps from logs of ticks: the sections of a Poincaré map, and the state, the command and the target of each step."""

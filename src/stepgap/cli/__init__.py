"""The command line: one file per verb. Robots and plants are chosen only here."""

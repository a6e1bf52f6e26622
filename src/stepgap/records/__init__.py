"""The files of a run, written and read in one place; logs of other programs; export to other programs."""

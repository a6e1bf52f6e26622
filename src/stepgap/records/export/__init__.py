"""Export of a run to other programs.

`columns` gives the steps as columns with units; `text`, `matlab` and `parquet` write them to files. `ticks` writes the
logged ticks between the steps.
"""

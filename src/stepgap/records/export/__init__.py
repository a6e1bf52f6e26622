"""What a run gives to other programs.

`columns` are its steps with units; `text`, `matlab` and `parquet` are files of them. `ticks` are files of what went on
between the steps, `mjcf` those of the twin as a model.
"""

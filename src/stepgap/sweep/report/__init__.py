"""Reports of sweeps: how the errors of many experiments depend on the settings on the axes.

`cases` makes one entry per case from the table of a sweep, and the levels of its axes. `levels` has the statistics of
levels, `variance_shares` the sensitivity. `figures` makes the figures, `level_tables` and `case_tables` the tables,
`sentences` the text. `page` puts all on one page and writes it.
"""

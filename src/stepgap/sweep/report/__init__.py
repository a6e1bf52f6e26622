"""Reports of sweeps: medians of the errors of many experiments by the values of the settings on the axes.

`cases` makes one entry per case from the table of a sweep, and the levels of its axes; `level_figure` draws their
medians; `page` puts figure, tables and sentences on one page and writes it.
"""

"""Logs of other programs as tables of numbers: one module per format, one function that reads them all."""

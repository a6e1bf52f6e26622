"""Nominal maps for robots without equations of motion: a template, a simulator with its surrogate, a log.

Read in this order: `affine_map` (a template of a few numbers), `simulator` (any program that computes a step),
`differenced_map` (whether its derivatives can be computed by differences, and with which step), `surrogate_map` (a
smooth map fitted to it), `log_map` (a map fitted to recorded steps).
"""

"""Helpers that all folders use.

They are for errors, files, settings files, plug-ins, JSON data, signals, random streams, the normal distribution and
compiled code.
"""

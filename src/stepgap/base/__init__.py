"""What every folder stands on.

Whole files, settings files, plug-ins, readers of JSON data, signals, random streams, the normal distribution, compiled
code.
"""

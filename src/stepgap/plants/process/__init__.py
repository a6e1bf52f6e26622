"""A robot that another program moves, in any language: it exchanges one line of JSON for each step.

Read in this order: `messages` (what the lines contain), `line_channel` (how they are exchanged), `process_plant`.
"""

from stepgap.plants.process.line_channel import Child, Connection
from stepgap.plants.process.messages import ProcessFault
from stepgap.plants.process.process_plant import ProcessPlant, Timeouts

__all__ = ["Child", "Connection", "ProcessFault", "ProcessPlant", "Timeouts"]

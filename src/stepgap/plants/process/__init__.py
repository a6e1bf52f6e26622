"""A robot that another program moves, in any language: it exchanges one line of JSON for each step.

Read in this order: `messages` (what the lines contain), `line_channel` (how they are exchanged), `process_plant`.
"""

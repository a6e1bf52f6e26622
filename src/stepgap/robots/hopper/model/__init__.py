"""The hopper's equations of motion, from the leg to the apex map.

Read in this order: `leg`, `dynamics`, `joint_control`, `reduced`, `hop`, `apex_map`, and `foothold_map`, whose state
also has the stride.
"""

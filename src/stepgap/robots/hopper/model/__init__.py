"""The hopper's equations of motion, from the leg to the apex map.

Read in this order: `leg`, `dynamics`, `joint_control`, `reduced`, `hop`, `apex_map`; `sampled_hop` and `sampled_map`
are the same with torques held from tick to tick, and `loads` is what a hop asks of motors and floor.
"""

"""From a log of commands and odometry to a corrected robot: `stepgap cure`.

Read in this order: `topics` (which columns of a log are commands and velocities), `drive` (how the robot moved),
`response` (how it follows its commands), `lesson` (what is learned from it), `habits` (what it does with which
command), `cure_page` and `cure_folder` (what is written), `velocity_filter` (the correction on the robot).
"""

"""What the hopper computes in a tick: sensing, phases, torques and their safety limits.

Read in this order: `sensors`, `phases`, `estimator`; `safety` with `limits`, `load`, `stage` and `plausibility`, which
tracks each encoder (`encoder_track`) and compares yaw and pitch with the leg (`closures`); `hop_state`, `sensing`,
`tick_torque`, `hop_tick`; `tick_row`, `hop_control`.
"""

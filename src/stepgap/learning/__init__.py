"""What reality taught: the error of a step map, learnt from recorded steps; knows no robot.

`settings` says what is learnt, `step_log` holds the steps, `residual` the models of actual − nominal (Eq. 12),
`gaussian_process` and `gaussian_process_fit` what is behind them, and `corrected_map` adds a residual to the nominal
map, which gives a step map again (Eq. 13).
"""

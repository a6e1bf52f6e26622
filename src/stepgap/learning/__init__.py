"""What reality taught: the error of a step map, learnt from recorded steps; knows no robot.

`step_log` holds the steps, and `observations` what they say of the nominal map: actual − nominal (Eq. 12). A
`residual` is a model of that, made of one `regression` for each state coordinate: a `polynomial`, or a
`gaussian_process_regression` with `gaussian_process` and `gaussian_process_fit` behind it. `residual_fit` fits
and chooses them, and `corrected_map` adds a residual to the nominal map, which gives a step map again (Eq. 13).
"""

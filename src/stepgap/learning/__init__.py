"""What reality taught: the error of a step map, learnt from recorded steps; knows no robot.

`settings` says what is learnt. A `learner` holds what is known between two steps of a deployment.

`step_log` holds the steps, and `observations` what they say of the nominal map: actual − nominal (Eq. 12).
`disturbance` is the part of it that depends on time and yaw, not on state and command. A `residual` is a model of the
rest, made of one `regression` for each state coordinate: `zero`, a `polynomial`, a `gaussian_process_regression`, or
one of another package, found by its name in `entry_points`. `residual_fit` fits and chooses them, `validation` compares
them on steps held out, and `corrected_map` adds a residual to the nominal map, which gives a step map again (Eq. 13).

Behind them are the Gaussian processes: `kernel`, `covariance`, `cholesky` and `least_squares` are the mathematics,
`gaussian_process` is the interface, `exact_gaussian_process` is for hundreds of steps and `sparse_gaussian_process` for
thousands, and `gaussian_process_fit` finds their hyper-parameters.
"""

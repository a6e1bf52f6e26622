"""What reality taught: the error of a step map, learnt from recorded steps; knows no robot.

`settings` says what is learnt. A `learner` holds what is known between two steps of a deployment.

`step_log` holds the steps, and `observations` what they say of the nominal map: actual − nominal (Eq. 12).
`disturbance` is the part of it that depends on time and yaw, not on state and command. A `residual` is a model of the
rest, made of one `regression` for each state coordinate: a `polynomial` or a `gaussian_process_regression`.
`residual_fit` fits and chooses them, and `corrected_map` adds a residual to the nominal map, which gives a step map
again (Eq. 13).

Behind them are the Gaussian processes: `covariance`, `cholesky` and `least_squares` are the mathematics,
`gaussian_process` is one conditioned on data, `gaussian_process_fit` finds its hyper-parameters, and
`sparse_gaussian_process` is for thousands of steps.
"""

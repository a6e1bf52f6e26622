"""What reality taught: the error of a step map, learnt from recorded steps; knows no robot.

`settings` says what is learnt, and a `learner` holds during a deployment what is, with the `drift` that it follows.

`step_log` holds the steps, and `observations` what they say of the nominal map: actual − nominal (Eq. 12), from which
`place_effects` are taken out. A `residual` is a model of that, made of one `regression` for each state coordinate: a
`polynomial` or a `gaussian_process_regression`. `residual_fit` fits and chooses them, and `corrected_map` adds a
residual to the nominal map, which gives a step map again (Eq. 13).

Behind them are the Gaussian processes: `covariance`, `cholesky` and `least_squares` are the mathematics,
`gaussian_process` is one conditioned on data, `gaussian_process_fit` finds its hyper-parameters, and
`sparse_gaussian_process` is for thousands of steps.
"""

"""What reality taught: the error of a step map, learnt from recorded steps; knows no robot.

`settings` says what is learnt, and a `learner` holds during a deployment what is, with the `drift` that it follows.

`step_log` holds the steps, and `observations` what they say of the nominal map: actual − nominal (Eq. 12), from which
`place_effects` are taken out. A `residual` is a model of that, made of one `regression` for each state coordinate:
`zero`, a `polynomial`, a `gaussian_process_regression`, or one of another package, found by its name in `entry_points`.
`residual_fit` fits and chooses them, `validation` compares them on steps held out, and `corrected_map` adds a residual
to the nominal map, which gives a step map again (Eq. 13).

Behind them are the Gaussian processes: `kernel`, `covariance`, `cholesky` and `least_squares` are the mathematics,
`gaussian_process` is the interface, `exact_gaussian_process` is for hundreds of steps and `sparse_gaussian_process` for
thousands, and `gaussian_process_fit` finds their hyper-parameters.
"""

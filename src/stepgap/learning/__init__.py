"""Learning of the residual: the error of a step map, learned from recorded steps; knows no robot.

`settings` are the user's settings. A `learner` is the state of learning between two steps of a deployment.

`steps` contains the steps, and `observations` the errors of the nominal map at them: actual − nominal (Eq. 12).
What is known of them is a few `beliefs`, each of which is a `belief`, from the `first_beliefs` on; they compete by how
probable they make the steps, and `posterior` is what their mixture says as a function of state and command. A
`residual` is a model that is fitted to the errors; beliefs are then about what it leaves. It has one `regression` for
each state coordinate: `zero`, a `polynomial`, a `gaussian_process_regression`, or one of another package, found by its
name in `entry_points`.
`residual_fit` fits and selects residuals, `residual_check` checks what their models return, `corrected_map` adds a
residual to the nominal map, which gives a step map again (Eq. 13), and `interval_calibration` keeps its intervals right
while a deployment goes on.
"""

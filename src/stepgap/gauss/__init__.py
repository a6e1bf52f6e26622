"""The mathematics of normal distributions that learning uses; it knows no robot, no step and no file.

`features` and `weights` are Bayesian linear regression, one value at a time: features of a point, a normal distribution
of their weights, and what a value says of them. `linear_regression` is least squares, with leave-one-out residuals.

The Gaussian process of the paper consists of `kernel`, `covariance` and `least_squares` (the mathematics),
`gaussian_process` (exact, or with inducing points for thousands of values), `evidence` and `gaussian_process_fit` (its
hyper-parameters).
"""

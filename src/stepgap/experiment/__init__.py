"""The method: settings, deployments, the loop, noise floor, replay, diagnosis; fits, cases, portable controllers."""

"""The method: settings, deployments, the loop, noise floor, replay."""

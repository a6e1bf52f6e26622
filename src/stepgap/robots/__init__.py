"""Robots, one folder each: physics model, joint control, sensors, limits and simulated twin."""

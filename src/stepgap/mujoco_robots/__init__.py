"""Robots from MuJoCo models and trained policies, and the walking and hopping robots that show them."""

"""Residuals fitted to the steps of a log, compared on held-out steps, and the corrected map applied to others."""

"""Residuals fitted to the steps of a log, and the corrected map applied to further ones."""

"""Logs of other programs: their tables, the steps in them, and residuals fitted to these."""

"""Ticks on their way out of the control loop: through shared memory, into MCAP files, and back as tables."""

"""Recording of ticks: through shared memory, into MCAP files, and back as tables."""

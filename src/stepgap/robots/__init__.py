"""Which machine: one folder per robot."""

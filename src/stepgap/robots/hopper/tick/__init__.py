"""What the hopper computes in a tick: sensing, phases, torques and their safety limits."""

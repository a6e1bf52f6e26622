"""A real robot: buses and drives, the loop in real time, commissioning, and the hopper's rigs on them."""

"""A run for other programs: its data, its corrected map, and its controller."""

"""A hopper on one leg in three dimensions: it moves forward and sideways, and its body can tilt."""

"""What `stepgap bench` measures, and the baselines that learning must beat."""

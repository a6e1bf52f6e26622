"""The measurements of `stepgap bench`, and the baselines with which learning is compared."""

"""The measurements of `benchmarks.speed`, and the baselines with which learning is compared."""

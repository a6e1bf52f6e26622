"""The twin: a MuJoCo simulation in place of the real robot; a `RealityGap` sets how it differs from the model."""

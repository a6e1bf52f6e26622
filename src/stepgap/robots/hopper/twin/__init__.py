"""The twin: a MuJoCo simulation in place of the real robot; a `RealityGap` sets how it differs from the model.

Read in this order: `reality_gap`, `model`, `devices`, `run_ticks`, `twin`, `simulation`.
"""

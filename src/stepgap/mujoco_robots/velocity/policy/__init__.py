"""A walking robot that a trained policy moves: a network in an ONNX file, which was trained elsewhere.

Read in this order: `policy_settings` (what `policy.toml` says of it), `onnx_network`, `observation` (what the network
is given), `policy_control`, `policy_model` (its MuJoCo model, with its gains), `policy_robot`. `proposal` finds out of
a network and a model what it can of `policy.toml`, and `policy_trial` opens the network without a risk; `trial` is a
program.
"""

"""A walking robot that a trained policy moves: a network in an ONNX file, which was trained elsewhere.

Read in this order: `policy_settings` (what `policy.toml` says of it), `onnx_file` (the file with all of its numbers),
`onnx_network`, `policy_model` (its MuJoCo model, with its gains), `policy_robot` (what the network is given, and what
its actions do). `training_files` finds what a training wrote of it, `training_formats` reads it, mostly from YAML
(`yaml_text`), and `proposal` makes of this and a model what it can of `policy.toml`.
"""

"""ESI files (EtherCAT Slave Information, ETG.2000): what a vendor says of its devices, compared with `rig.toml`.

Read in this order: `tree` (XML that nobody trusts), `reader` (what is used of it), `comparison` (findings
about `rig.toml`), `proposal` (text for a `rig.toml`).
"""

"""Twins that agree with Fig. 4 of the paper; `paper_family.toml` tells how they were found."""

from collections.abc import Mapping
from importlib.resources import files

from stepgap.base.settings_file import parse_toml
from stepgap.robots.hopper.twin.reality_gap import RealityGap

_TABLES = parse_toml(files("stepgap.robots.hopper.twin").joinpath("paper_family.toml").read_text("utf-8"))

PAPER_FAMILY: Mapping[str, RealityGap] = {name: RealityGap(**table) for name, table in _TABLES.items()}
"""The twins by the names of their presets."""

"""Writes the page of settings from the docstrings of their classes: `./go python docs/settings_page.py`."""

from pathlib import Path

from stepgap.experiment.settings_text import settings_page

ROBOTS = ("hopper", "quadruped", "monopod", "velocity", "policy")

if __name__ == "__main__":
    Path(__file__).with_name("settings.md").write_text(settings_page(ROBOTS), encoding="utf-8")

"""The verb of this folder."""

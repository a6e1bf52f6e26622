"""The hopper's equations of motion, from the leg to the apex map."""

"""Sweeps: many experiments whose settings differ along axes."""

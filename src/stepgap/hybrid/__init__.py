"""Integration of motion that impacts interrupt; knows no robot."""

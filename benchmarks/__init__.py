"""Measurements behind the documentation's figures: `python -m benchmarks.NAME`."""

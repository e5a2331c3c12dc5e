"""Benchmarks of the toolkit: `python -m benchmarks` runs them all; see README.md."""

"""Pixels that are not alike: simulated, measured, and found."""

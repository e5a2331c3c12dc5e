"""Lenses found from a specification, by nlopt."""

"""Eikonal tiles of a whole field, summed in two levels."""

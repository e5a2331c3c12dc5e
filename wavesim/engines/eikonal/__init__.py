"""Eikonal tiles: rays carry the phase of the light, Fourier transforms carry the object."""

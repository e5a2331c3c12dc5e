"""Nonuniform Fourier transforms, and vectors of numbers in compiled loops."""

"""Fourier transforms where SciPy's would take most of the time, in compiled loops over whole vectors."""

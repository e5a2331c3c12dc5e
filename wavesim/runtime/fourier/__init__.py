"""Fast Fourier transforms in compiled vector loops, for places where SciPy would take most of the time."""

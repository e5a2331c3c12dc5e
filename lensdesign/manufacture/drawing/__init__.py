"""ISO 10110 drawings of the elements."""

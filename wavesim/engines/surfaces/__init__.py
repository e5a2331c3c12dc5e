"""Waves at curved surfaces: where they cross, and the grid that holds them."""

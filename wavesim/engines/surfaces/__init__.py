"""Waves at curved surfaces: samples of the surfaces, and the grid on which the waves are sampled."""

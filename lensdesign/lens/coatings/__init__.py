"""Coatings of surfaces: their description in design files, film materials, and the transfer-matrix method."""

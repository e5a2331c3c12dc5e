"""Feasibility limits of a specification: field, aperture, pixel pitch and tolerances."""

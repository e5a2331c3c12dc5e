"""How far a specification can be taken: limits of field, aperture, pixel and tolerances."""

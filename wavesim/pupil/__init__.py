"""The reconstruction pupil: what a perturbed lens leaves of a point after reconstruction, in milliseconds."""

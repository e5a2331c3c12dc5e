"""Merits of the whole imaging chain: object, frames recorded through the perturbed lens, reconstruction."""

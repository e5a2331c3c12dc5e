"""Merits of the whole chain: object, frames recorded through the perturbed lens, reconstruction."""

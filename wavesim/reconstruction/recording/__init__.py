"""Planes behind a lens: what they recorded, what the model sees there, and what that changes."""

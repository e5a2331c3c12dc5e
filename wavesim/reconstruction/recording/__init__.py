"""Measured planes behind a lens: modelled intensities of their pixels, and the resulting changes."""

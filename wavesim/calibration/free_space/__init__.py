"""Frames in free space without a lens: their stack, the descent, and the resulting field."""

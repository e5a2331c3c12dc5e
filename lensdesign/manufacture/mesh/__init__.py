"""Closed triangle meshes of the glass, written, read back and verified."""

"""Closed triangle meshes of the glass: creation, files, and verification against the design."""

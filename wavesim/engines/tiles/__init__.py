"""Eikonal tiles: the default engine for a patch of the object."""

"""Rays that engines and pupils share: aimed at points, in bundles, and fitted as smooth maps."""

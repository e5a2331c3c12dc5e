"""Rays that engines and pupils share: aimed at points, in bundles, and fitted as smooth maps."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

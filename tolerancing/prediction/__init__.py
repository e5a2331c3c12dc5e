"""Predictions of wavefronts, rays and yields of lenses as built, from derivatives of the nominal lens."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

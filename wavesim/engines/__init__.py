"""Engines that propagate fields from the object through the lens, and the choice between them."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

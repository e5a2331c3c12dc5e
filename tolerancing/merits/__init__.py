"""Figures of merit of perturbed lenses, and compensators of the reconstruction."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

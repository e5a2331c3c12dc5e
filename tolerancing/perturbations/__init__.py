"""Perturbations: parameters, their distributions, random draws, and the perturbed systems."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

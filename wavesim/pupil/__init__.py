"""The reconstruction pupil: what a perturbed lens leaves of a point after reconstruction, in milliseconds."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

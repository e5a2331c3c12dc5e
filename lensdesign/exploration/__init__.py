"""Trade-offs: fronts of lenses of which none is better in everything, and how far a specification reaches."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

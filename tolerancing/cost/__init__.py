"""Cost of tolerances: price tables by process, and the cost of a study's tolerances."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

"""Where rays go: the compiled lens, bundles, the trace, its derivatives and its extremes."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

"""Sequential ray tracing: the compiled lens, bundles, traces, their derivatives and extreme rays."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

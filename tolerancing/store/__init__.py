"""Where trials are kept: one SQLite file that survives being killed, and tables of it for other programs."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

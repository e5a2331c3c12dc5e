"""Store of a study: one SQLite file that survives interruptions, and its export as tables."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

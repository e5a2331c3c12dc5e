"""Stock lenses: an index of vendors' lens files, and a search for those that meet a specification."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

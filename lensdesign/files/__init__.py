"""Files that hold lenses: design files of our own, measured figures, Zemax and CODE V."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

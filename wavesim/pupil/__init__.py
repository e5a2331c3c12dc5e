"""The reconstruction pupil: point spread of a reconstruction through the nominal lens, in milliseconds."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

"""The lens model: surfaces, shapes, glasses, measured figures, poses, edges and the solid glass bodies."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

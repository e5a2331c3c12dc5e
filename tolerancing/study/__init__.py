"""A tolerance study: its file, its series of steps, and how a trial or a step is scored."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

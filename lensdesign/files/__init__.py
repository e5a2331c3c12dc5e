"""Lens files: design files (TOML), measured sag-error maps, and files of OpticStudio, CODE V and OSLO."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

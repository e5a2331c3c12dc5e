"""Files for the manufacture of a lens: triangle meshes, STEP files and drawings after ISO 10110."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

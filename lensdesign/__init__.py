"""Design of non-imaging spatial information transfer lenses: geometry, rays, optimization, meshes."""

import lazy_loader

# Public names are listed in __init__.pyi, and imported where they are first used.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

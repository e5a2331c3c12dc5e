"""What a lens is: surfaces and their shapes, glasses, measured figures, poses, edges, and the solid they
bound.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

"""What a bench does not tell, found from its frames: how the lens is mounted."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

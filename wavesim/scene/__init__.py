"""What is carried where: lens, object grid, exit grid; and what every engine can be asked."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

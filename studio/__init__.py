"""A workbench in the browser: change a lens and see at once what it does."""

import lazy_loader

# Public names are listed in __init__.pyi, and imported where they are first used.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

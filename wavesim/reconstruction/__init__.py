"""The object from recorded frames: object-domain descent, and the retrieval of Appendix A."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

"""The report: one content, as a page and as a PDF; and the picture of one trial."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

"""The report of a study as an HTML page and a PDF with the same content, and figures of single trials."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

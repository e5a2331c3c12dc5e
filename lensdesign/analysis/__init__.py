"""Analysis of a lens: matching (Eq. 1), spread (Eq. 2), arrival angles, first order, form errors, check."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

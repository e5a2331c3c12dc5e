"""What perturbations do to wavefronts, from the rays of the nominal lens."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

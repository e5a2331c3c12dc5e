"""What a perturbed lens is scored by: rays, reconstruction pupil, waves, bars, or Python; and what the
reconstruction compensates before.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

"""What can be wrong with a lens as made and mounted, and how likely: parameters, distributions, draws, and
the perturbed systems that follow.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

from .ray_bundles import FoldError

__all__ = [
    "FoldError",
]

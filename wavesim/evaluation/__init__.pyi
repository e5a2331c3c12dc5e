from .accuracy import OracleResult, run_oracle
from .ghosts import FoundGhost, GhostPlane, ghost_in_residuals
from .metrics import (
    ElementContrast,
    bar_contrast,
    element_contrasts,
    object_correlation,
    resolved_elements,
    smallest_resolved_element,
)
from .passed import OpenDirections, as_passed, open_directions
from .resolving import LineContrast, Resolved, bars_field, resolve, resolving_seconds
from .similarity import psnr_db, ssim

__all__ = [
    "ElementContrast",
    "FoundGhost",
    "GhostPlane",
    "LineContrast",
    "OpenDirections",
    "OracleResult",
    "Resolved",
    "as_passed",
    "bar_contrast",
    "bars_field",
    "element_contrasts",
    "ghost_in_residuals",
    "object_correlation",
    "open_directions",
    "psnr_db",
    "resolve",
    "resolved_elements",
    "resolving_seconds",
    "run_oracle",
    "smallest_resolved_element",
    "ssim",
]

from .accuracy import OracleResult, run_oracle
from .charts import ChartResolution, Registration, chart_resolution, register_chart
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
    "ChartResolution",
    "ElementContrast",
    "FoundGhost",
    "GhostPlane",
    "LineContrast",
    "OpenDirections",
    "OracleResult",
    "Registration",
    "Resolved",
    "as_passed",
    "bar_contrast",
    "bars_field",
    "chart_resolution",
    "element_contrasts",
    "ghost_in_residuals",
    "object_correlation",
    "open_directions",
    "psnr_db",
    "register_chart",
    "resolve",
    "resolved_elements",
    "resolving_seconds",
    "run_oracle",
    "smallest_resolved_element",
    "ssim",
]

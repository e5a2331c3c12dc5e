from .accuracy import AnalyticResult, run_analytic_case
from .charts import ChartResolution, Registration, chart_resolution, register_chart
from .contrast import (
    ElementContrast,
    bar_contrast,
    element_contrasts,
    object_correlation,
    resolved_elements,
    smallest_resolved_element,
)
from .ghosts import FoundGhost, GhostPlane, ghost_in_residuals
from .resolving import LineContrast, Resolved, bars_field, resolve, resolving_seconds
from .similarity import psnr_db, ssim
from .transmitted_band import TransmittedDirections, transmitted_directions, transmitted_part

__all__ = [
    "AnalyticResult",
    "ChartResolution",
    "ElementContrast",
    "FoundGhost",
    "GhostPlane",
    "LineContrast",
    "Registration",
    "Resolved",
    "TransmittedDirections",
    "bar_contrast",
    "bars_field",
    "chart_resolution",
    "element_contrasts",
    "ghost_in_residuals",
    "object_correlation",
    "psnr_db",
    "register_chart",
    "resolve",
    "resolved_elements",
    "resolving_seconds",
    "run_analytic_case",
    "smallest_resolved_element",
    "ssim",
    "transmitted_directions",
    "transmitted_part",
]

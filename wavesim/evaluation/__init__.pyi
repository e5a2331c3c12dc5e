from .accuracy import OracleResult, run_oracle
from .metrics import (
    ElementContrast,
    as_passed,
    bar_contrast,
    element_contrasts,
    object_correlation,
    resolved_elements,
    smallest_resolved_element,
)
from .resolving import LineContrast, Resolved, bars_field, resolve
from .similarity import psnr_db, ssim

__all__ = [
    "ElementContrast",
    "LineContrast",
    "OracleResult",
    "Resolved",
    "as_passed",
    "bar_contrast",
    "bars_field",
    "element_contrasts",
    "object_correlation",
    "psnr_db",
    "resolve",
    "resolved_elements",
    "run_oracle",
    "smallest_resolved_element",
    "ssim",
]

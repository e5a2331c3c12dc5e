from .field import Field, Grid, correlation, relative_error
from .files import read_field, write_field
from .propagator import FreeSpacePropagator, propagate
from .sampling_checks import (
    SamplingWarning,
    check_propagation,
    critical_distance_mm,
    predicted_relative_error,
)
from .spectrum import SpectrumSupport, spectrum_support

__all__ = [
    "Field",
    "FreeSpacePropagator",
    "Grid",
    "SamplingWarning",
    "SpectrumSupport",
    "check_propagation",
    "correlation",
    "critical_distance_mm",
    "predicted_relative_error",
    "propagate",
    "read_field",
    "relative_error",
    "spectrum_support",
    "write_field",
]

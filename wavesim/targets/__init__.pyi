from .illumination import field_stop, gaussian_beam, measured_field, plane_wave, point_source, speckle
from .patch import (
    Patch,
    Target,
    make_illumination,
    make_target,
    object_patch,
    read_object,
    transmission_of,
    usaf_charts_of,
    usaf_elements_of,
)
from .patterns import band_limit, phase_target, picture_target, siemens_star
from .phantom import tissue_phantom
from .usaf import usaf_chart, usaf_elements, usaf_elements_within, usaf_line_width_um

__all__ = [
    "Patch",
    "Target",
    "band_limit",
    "field_stop",
    "gaussian_beam",
    "make_illumination",
    "make_target",
    "measured_field",
    "object_patch",
    "phase_target",
    "picture_target",
    "plane_wave",
    "point_source",
    "read_object",
    "siemens_star",
    "speckle",
    "tissue_phantom",
    "transmission_of",
    "usaf_chart",
    "usaf_charts_of",
    "usaf_elements",
    "usaf_elements_of",
    "usaf_elements_within",
    "usaf_line_width_um",
]

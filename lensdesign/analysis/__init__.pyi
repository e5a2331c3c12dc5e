from .check import check_design
from .coatings import CoatingReport, coating_report
from .double_reflections import GhostPath, GhostPaths, GhostSampling, ghost_paths
from .exit_beam import footprint, largest_spread_angle, observation_distance_mm, rms_spot_diameter
from .form_error import form_errors, pv_rms_waves
from .ghosts import GhostReport, ghost_report
from .moulding import MouldingCheck, moulding_checks
from .oversampling import Oversampling, oversampling_of
from .paraxial import cardinal_points, first_order
from .report import CheckReport
from .roughness import RoughnessReport, roughness_report
from .sag_tables import SagTable, sag_table, write_sag_table
from .space_bandwidth import match, spread_limit_sine

__all__ = [
    "CheckReport",
    "CoatingReport",
    "GhostPath",
    "GhostPaths",
    "GhostReport",
    "GhostSampling",
    "MouldingCheck",
    "Oversampling",
    "RoughnessReport",
    "SagTable",
    "cardinal_points",
    "check_design",
    "coating_report",
    "first_order",
    "footprint",
    "form_errors",
    "ghost_paths",
    "ghost_report",
    "largest_spread_angle",
    "match",
    "moulding_checks",
    "observation_distance_mm",
    "oversampling_of",
    "pv_rms_waves",
    "rms_spot_diameter",
    "roughness_report",
    "sag_table",
    "spread_limit_sine",
    "write_sag_table",
]

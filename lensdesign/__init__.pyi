from .check import CheckReport, check_design
from .errors import DesignError, InputError, MaterialError, TransferLensError
from .figure import SurfaceFigure, figure_from_grid, figure_from_zernike
from .figure_files import read_figure_grid, write_figure_grid
from .figure_source import FigureSource
from .files import load_design, save_design
from .form_error import form_errors, pv_rms_waves
from .poses import Pose, SurfacePerturbation
from .scaling import scaled
from .system import Lens, ObjectSpace, Sensor, Surface
from .tracing import RayTrace, trace

__all__ = [
    "CheckReport",
    "DesignError",
    "FigureSource",
    "InputError",
    "Lens",
    "MaterialError",
    "ObjectSpace",
    "Pose",
    "RayTrace",
    "Sensor",
    "Surface",
    "SurfaceFigure",
    "SurfacePerturbation",
    "TransferLensError",
    "check_design",
    "figure_from_grid",
    "figure_from_zernike",
    "form_errors",
    "load_design",
    "pv_rms_waves",
    "read_figure_grid",
    "save_design",
    "scaled",
    "trace",
    "write_figure_grid",
]

from .cad import export_step
from .check import CheckReport, check_design
from .codev import read_seq, write_seq
from .drawing import DrawingOptions, lens_drawing, write_drawing
from .drawing_tolerances import DrawingTolerances, SurfaceTolerances
from .edges import Edge, Flange
from .errors import DesignError, InputError, MaterialError, TransferLensError
from .exchange import Imported, LossyImportError, Supplement
from .figure import SurfaceFigure, figure_from_grid, figure_from_zernike
from .figure_files import read_figure_grid, write_figure_grid
from .figure_source import FigureSource
from .files import load_design, save_design
from .form_error import form_errors, pv_rms_waves
from .mesh import export_mesh, lens_mesh
from .mesh_scene import export_scene
from .mesh_verification import verify_mesh
from .poses import Pose, SurfacePerturbation
from .sag_tables import sag_table, write_sag_table
from .scaling import scaled
from .system import Lens, ObjectSpace, Sensor, Surface
from .tracing import RayTrace, trace
from .view import write_view
from .zemax import read_zmx, write_zmx

__all__ = [
    "CheckReport",
    "DesignError",
    "DrawingOptions",
    "DrawingTolerances",
    "Edge",
    "FigureSource",
    "Flange",
    "Imported",
    "InputError",
    "Lens",
    "LossyImportError",
    "MaterialError",
    "ObjectSpace",
    "Pose",
    "RayTrace",
    "Sensor",
    "Supplement",
    "Surface",
    "SurfaceFigure",
    "SurfacePerturbation",
    "SurfaceTolerances",
    "TransferLensError",
    "check_design",
    "export_mesh",
    "export_scene",
    "export_step",
    "figure_from_grid",
    "figure_from_zernike",
    "form_errors",
    "lens_drawing",
    "lens_mesh",
    "load_design",
    "pv_rms_waves",
    "read_figure_grid",
    "read_seq",
    "read_zmx",
    "sag_table",
    "save_design",
    "scaled",
    "trace",
    "verify_mesh",
    "write_drawing",
    "write_figure_grid",
    "write_sag_table",
    "write_seq",
    "write_view",
    "write_zmx",
]

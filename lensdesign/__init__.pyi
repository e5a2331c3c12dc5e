from .analysis.check import check_design
from .analysis.form_error import form_errors, pv_rms_waves
from .analysis.report import CheckReport
from .analysis.sag_tables import sag_table, write_sag_table
from .errors import DesignError, InputError, MaterialError, TransferLensError
from .fabrication.drawing.sheets import DrawingOptions, lens_drawing, write_drawing
from .fabrication.drawing.tolerances import DrawingTolerances, SurfaceTolerances
from .fabrication.mesh.mesh import lens_mesh, write_mesh
from .fabrication.mesh.verification import verify_mesh
from .fabrication.step.export import write_step
from .files.codev import read_seq, write_seq
from .files.design import load_design, save_design
from .files.draft import Imported, LossyImportError, Supplement
from .files.figures import read_figure_grid, write_figure_grid
from .files.zemax import read_zmx, write_zmx
from .lens.edges import Edge, Flange
from .lens.figure import SurfaceFigure, figure_from_grid, figure_from_zernike
from .lens.figure_source import FigureSource
from .lens.lens import Lens, ObjectSpace, Sensor
from .lens.poses import Pose, SurfacePerturbation
from .lens.scaling import scaled
from .lens.surface import Surface
from .pictures.glb import write_scene
from .pictures.page import write_view
from .tracing.rays import RayTrace, trace

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
    "write_mesh",
    "write_sag_table",
    "write_scene",
    "write_seq",
    "write_step",
    "write_view",
    "write_zmx",
]

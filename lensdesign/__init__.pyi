from .analysis.check import CheckReport, check_design
from .analysis.form_error import form_errors, pv_rms_waves
from .analysis.sag_tables import sag_table, write_sag_table
from .errors import DesignError, InputError, MaterialError, TransferLensError
from .fabrication.drawing.sheets import DrawingOptions, lens_drawing, write_drawing
from .fabrication.drawing.tolerances import DrawingTolerances, SurfaceTolerances
from .fabrication.mesh.mesh import export_mesh, lens_mesh
from .fabrication.mesh.verification import verify_mesh
from .fabrication.step.export import export_step
from .files.codev import read_seq, write_seq
from .files.design import load_design, save_design
from .files.draft import Imported, LossyImportError, Supplement
from .files.figures import read_figure_grid, write_figure_grid
from .files.zemax import read_zmx, write_zmx
from .lens.edges import Edge, Flange
from .lens.figure import SurfaceFigure, figure_from_grid, figure_from_zernike
from .lens.figure_source import FigureSource
from .lens.lens import Lens, ObjectSpace, Sensor, Surface
from .lens.poses import Pose, SurfacePerturbation
from .lens.scaling import scaled
from .pictures.glb import export_scene
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

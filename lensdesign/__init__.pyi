from .analysis.check import check_design
from .analysis.moulding import MouldingCheck, moulding_checks
from .analysis.report import CheckReport
from .common.consent import trust_user_code
from .errors import DesignError, InputError, MaterialError, TransferLensError
from .files.codev import read_seq, write_seq
from .files.design import load_design, save_design
from .files.oslo import read_len
from .files.zemax import read_zmx, write_zmx
from .lens.coatings.coating import Coating, CoatingLayer
from .lens.cover_glass import CoverGlass
from .lens.edges import Edge, Flange, Gate
from .lens.glass import get_material
from .lens.lens import Lens, ObjectSpace, Sensor
from .lens.moulding import Moulding
from .lens.poses import Pose, SurfacePerturbation
from .lens.scaling import scaled
from .lens.surface import Surface
from .lens.surface_figure_source import SurfaceFigureSource
from .lens.surface_roughness import SurfaceRoughness
from .manufacture.drawing.sheets import lens_drawing, write_drawing
from .manufacture.dxf.outline import write_outline
from .manufacture.mesh.mesh import write_mesh
from .manufacture.mesh.reading import read_mesh
from .manufacture.mesh.verification import verify_mesh
from .manufacture.step.writing import write_step
from .optimization.result import OptimizationResult
from .optimization.search import optimize
from .optimization.specification.specification import Specification, load_specification
from .plots.glb import write_scene
from .plots.page import write_view
from .plots.plots import draw_all
from .raytrace.bundles import launch, pupil_hexapolar
from .raytrace.polarization import PolarizedRays, trace_polarized
from .raytrace.rays import RayTrace, trace
from .stock.index import StockIndex, index_stock
from .stock.search import StockResult, StockSettings, find_stock_lenses

__all__ = [
    "CheckReport",
    "Coating",
    "CoatingLayer",
    "CoverGlass",
    "DesignError",
    "Edge",
    "Flange",
    "Gate",
    "InputError",
    "Lens",
    "MaterialError",
    "Moulding",
    "MouldingCheck",
    "ObjectSpace",
    "OptimizationResult",
    "PolarizedRays",
    "Pose",
    "RayTrace",
    "Sensor",
    "Specification",
    "StockIndex",
    "StockResult",
    "StockSettings",
    "Surface",
    "SurfaceFigureSource",
    "SurfacePerturbation",
    "SurfaceRoughness",
    "TransferLensError",
    "check_design",
    "draw_all",
    "find_stock_lenses",
    "get_material",
    "index_stock",
    "launch",
    "lens_drawing",
    "load_design",
    "load_specification",
    "moulding_checks",
    "optimize",
    "pupil_hexapolar",
    "read_len",
    "read_mesh",
    "read_seq",
    "read_zmx",
    "save_design",
    "scaled",
    "trace",
    "trace_polarized",
    "trust_user_code",
    "verify_mesh",
    "write_drawing",
    "write_mesh",
    "write_outline",
    "write_scene",
    "write_seq",
    "write_step",
    "write_view",
    "write_zmx",
]

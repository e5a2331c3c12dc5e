from .edges import Edge, Flange
from .figure import SurfaceFigure, figure_from_grid, figure_from_zernike
from .figure_source import FigureSource
from .glass import get_material, glass_summary, list_glasses, refractive_index
from .lens import Lens, ObjectSpace, Sensor
from .meridian import SurfaceMeridian
from .poses import Pose, SurfacePerturbation, rotation_matrix
from .scaling import scaled
from .solid import Element, closed_elements
from .surface import Surface
from .temperature import lens_at_temperature
from .zernikes import zernike, zernike_orders

__all__ = [
    "Edge",
    "Element",
    "FigureSource",
    "Flange",
    "Lens",
    "ObjectSpace",
    "Pose",
    "Sensor",
    "Surface",
    "SurfaceFigure",
    "SurfaceMeridian",
    "SurfacePerturbation",
    "closed_elements",
    "figure_from_grid",
    "figure_from_zernike",
    "get_material",
    "glass_summary",
    "lens_at_temperature",
    "list_glasses",
    "refractive_index",
    "rotation_matrix",
    "scaled",
    "zernike",
    "zernike_orders",
]

from .coatings.coating import Coating, CoatingLayer
from .coatings.film_materials import film_index
from .coatings.thin_films import Coefficients, film_coefficients
from .cover_glass import CoverGlass
from .edges import Edge, Flange, Gate
from .glass import get_material, glass_summary, list_glasses, refractive_index
from .lens import Lens, ObjectSpace, Sensor
from .meridian import SurfaceMeridian
from .moulding import Moulding
from .poses import Pose, SurfacePerturbation, rotation_matrix
from .scaling import scaled
from .solid import Element, closed_elements
from .surface import Surface
from .surface_figure import SurfaceFigure, surface_figure_from_grid, surface_figure_from_zernike
from .surface_figure_source import SurfaceFigureSource
from .temperature import lens_at_temperature
from .zernikes import zernike, zernike_orders

__all__ = [
    "Coating",
    "CoatingLayer",
    "Coefficients",
    "CoverGlass",
    "Edge",
    "Element",
    "Flange",
    "Gate",
    "Lens",
    "Moulding",
    "ObjectSpace",
    "Pose",
    "Sensor",
    "Surface",
    "SurfaceFigure",
    "SurfaceFigureSource",
    "SurfaceMeridian",
    "SurfacePerturbation",
    "closed_elements",
    "film_coefficients",
    "film_index",
    "get_material",
    "glass_summary",
    "lens_at_temperature",
    "list_glasses",
    "refractive_index",
    "rotation_matrix",
    "scaled",
    "surface_figure_from_grid",
    "surface_figure_from_zernike",
    "zernike",
    "zernike_orders",
]

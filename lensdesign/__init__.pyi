from .errors import DesignError, InputError, MaterialError, TransferLensError
from .files import load_design, save_design
from .poses import Pose, SurfacePerturbation
from .system import Lens, ObjectSpace, Sensor, Surface

__all__ = [
    "DesignError",
    "InputError",
    "Lens",
    "MaterialError",
    "ObjectSpace",
    "Pose",
    "Sensor",
    "Surface",
    "SurfacePerturbation",
    "TransferLensError",
    "load_design",
    "save_design",
]

from .check import CheckReport, check_design
from .errors import DesignError, InputError, MaterialError, TransferLensError
from .files import load_design, save_design
from .poses import Pose, SurfacePerturbation
from .scaling import scaled
from .system import Lens, ObjectSpace, Sensor, Surface
from .tracing import RayTrace, trace

__all__ = [
    "CheckReport",
    "DesignError",
    "InputError",
    "Lens",
    "MaterialError",
    "ObjectSpace",
    "Pose",
    "RayTrace",
    "Sensor",
    "Surface",
    "SurfacePerturbation",
    "TransferLensError",
    "check_design",
    "load_design",
    "save_design",
    "scaled",
    "trace",
]

"""Design of non-imaging spatial information transfer lenses: geometry, rays, optimization, meshes."""

from lensdesign.errors import DesignError, InputError, MaterialError, TransferLensError
from lensdesign.files import load_design, save_design
from lensdesign.poses import Pose, SurfacePerturbation
from lensdesign.system import Lens, ObjectSpace, Sensor, Surface

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

from .estimation import Calibrated, calibrate
from .from_frames import calibrate_frames

__all__ = [
    "Calibrated",
    "calibrate",
    "calibrate_frames",
]

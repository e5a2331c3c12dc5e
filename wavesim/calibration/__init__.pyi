from .calibrated import Calibrated, read_calibration
from .estimation import calibrate
from .free_space.field import FreeSpaceField, reconstruct_free_space
from .from_frames import calibrate_empty, calibrate_frames
from .planning import Plan, Plans, plan_frames

__all__ = [
    "Calibrated",
    "FreeSpaceField",
    "Plan",
    "Plans",
    "calibrate",
    "calibrate_empty",
    "calibrate_frames",
    "plan_frames",
    "read_calibration",
    "reconstruct_free_space",
]

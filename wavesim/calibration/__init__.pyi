from .calibration_result import Calibrated, read_bench, read_calibration
from .frame_calibration import calibrate_empty, calibrate_frames
from .free_space import FreeSpaceField, reconstruct_free_space
from .planning import Plan, Plans, plan_frames

__all__ = [
    "Calibrated",
    "FreeSpaceField",
    "Plan",
    "Plans",
    "calibrate_empty",
    "calibrate_frames",
    "plan_frames",
    "read_bench",
    "read_calibration",
    "reconstruct_free_space",
]

from .characteristic import PointCharacteristic, PupilSampler
from .focus import FocalPlanes, best_focus
from .line_pairs import (
    line_pair_contrast,
    line_pair_displacement_um,
    line_pair_image,
    line_pair_profile,
    smallest_resolved_line_width_um,
)
from .linearised_reconstruction import LinearisedReconstruction, expected_loss
from .meridian import Meridian
from .patch_reconstructor import PatchReconstructor, patch_bar_contrast
from .pupil import (
    PupilGrid,
    ReconstructionPupil,
    Refocused,
    mtf,
    psf,
    refocus,
    remove_shift,
    rms_waves,
    strehl,
)
from .ray_aiming import RayAimError

__all__ = [
    "FocalPlanes",
    "LinearisedReconstruction",
    "Meridian",
    "PatchReconstructor",
    "PointCharacteristic",
    "PupilGrid",
    "PupilSampler",
    "RayAimError",
    "ReconstructionPupil",
    "Refocused",
    "best_focus",
    "expected_loss",
    "line_pair_contrast",
    "line_pair_displacement_um",
    "line_pair_image",
    "line_pair_profile",
    "mtf",
    "patch_bar_contrast",
    "psf",
    "refocus",
    "remove_shift",
    "rms_waves",
    "smallest_resolved_line_width_um",
    "strehl",
]

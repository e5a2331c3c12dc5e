from .characteristic import PointCharacteristic, PupilSampler
from .focus import best_focus
from .line_pairs import (
    line_pair_contrast,
    line_pair_displacement_um,
    line_pair_image,
    line_pair_profile,
    smallest_resolved_line_width_um,
)
from .linearised_chain import LinearisedChain, expected_loss
from .meridian import Meridian
from .patch_chain import PatchChain, chain_contrast
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
    "LinearisedChain",
    "Meridian",
    "PatchChain",
    "PointCharacteristic",
    "PupilGrid",
    "PupilSampler",
    "RayAimError",
    "ReconstructionPupil",
    "Refocused",
    "best_focus",
    "chain_contrast",
    "expected_loss",
    "line_pair_contrast",
    "line_pair_displacement_um",
    "line_pair_image",
    "line_pair_profile",
    "mtf",
    "psf",
    "refocus",
    "remove_shift",
    "rms_waves",
    "smallest_resolved_line_width_um",
    "strehl",
]

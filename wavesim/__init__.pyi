from .line_pairs import (
    line_pair_contrast,
    line_pair_displacement_um,
    line_pair_image,
    line_pair_profile,
    smallest_resolved_line_width_um,
)
from .point_characteristic import (
    FoldError,
    PointCharacteristic,
    PupilSampler,
    RayAimError,
)
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

__all__ = [
    "FoldError",
    "PointCharacteristic",
    "PupilGrid",
    "PupilSampler",
    "RayAimError",
    "ReconstructionPupil",
    "Refocused",
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

from .chirp_z import propagate_to, propagate_to_adjoint
from .choosing import Choice, Prediction, choose, chosen_engine, predict
from .eikonal import EikonalTiles
from .engine import Cost, Engine, Neglected, Scene
from .engines import make_engine
from .fields import Field, Grid, correlation, relative_error
from .free_space import propagate, propagate_adjoint
from .guards import (
    SamplingWarning,
    check_propagation,
    critical_distance_mm,
    predicted_relative_error,
)
from .line_pairs import (
    line_pair_contrast,
    line_pair_displacement_um,
    line_pair_image,
    line_pair_profile,
    smallest_resolved_line_width_um,
)
from .no_lens import NoLens
from .oracles import OracleCase, OracleResult, oracle_case, run_oracle
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
from .resolving import LineContrast, Resolved, bars_field, resolve
from .scenes import patch_scene
from .slices import AnnularSlices
from .thin_lens import ThinLens
from .tilted_planes import from_tilted_plane, to_tilted_plane
from .wave_propagation import WavePropagation
from .working_grid import TotalReflectionWarning

__all__ = [
    "AnnularSlices",
    "Choice",
    "Cost",
    "EikonalTiles",
    "Engine",
    "Field",
    "FoldError",
    "Grid",
    "LineContrast",
    "Neglected",
    "NoLens",
    "OracleCase",
    "OracleResult",
    "PointCharacteristic",
    "Prediction",
    "PupilGrid",
    "PupilSampler",
    "RayAimError",
    "ReconstructionPupil",
    "Refocused",
    "Resolved",
    "SamplingWarning",
    "Scene",
    "ThinLens",
    "TotalReflectionWarning",
    "WavePropagation",
    "bars_field",
    "check_propagation",
    "choose",
    "chosen_engine",
    "correlation",
    "critical_distance_mm",
    "from_tilted_plane",
    "line_pair_contrast",
    "line_pair_displacement_um",
    "line_pair_image",
    "line_pair_profile",
    "make_engine",
    "mtf",
    "oracle_case",
    "patch_scene",
    "predict",
    "predicted_relative_error",
    "propagate",
    "propagate_adjoint",
    "propagate_to",
    "propagate_to_adjoint",
    "psf",
    "refocus",
    "relative_error",
    "remove_shift",
    "resolve",
    "rms_waves",
    "run_oracle",
    "smallest_resolved_line_width_um",
    "strehl",
    "to_tilted_plane",
]

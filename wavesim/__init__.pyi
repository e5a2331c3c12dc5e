from .chirp_z import propagate_to, propagate_to_adjoint
from .choosing import Choice, Prediction, choose, chosen_engine, predict
from .eikonal import EikonalTiles
from .engine import Cost, Engine, Neglected, Scene
from .engines import make_engine
from .fields import Field, Grid, correlation, relative_error
from .frames import Frame, FrameSettings, read_frame, write_frame
from .free_space import propagate, propagate_adjoint
from .guards import (
    SamplingWarning,
    check_propagation,
    critical_distance_mm,
    predicted_relative_error,
)
from .illumination import field_stop, gaussian_beam, measured_field, plane_wave
from .line_pairs import (
    line_pair_contrast,
    line_pair_displacement_um,
    line_pair_image,
    line_pair_profile,
    smallest_resolved_line_width_um,
)
from .no_lens import NoLens
from .oracles import OracleCase, OracleResult, oracle_case, run_oracle
from .phantom import tissue_phantom
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
from .reconstruction import Reconstructed, prox_tv, reconstruct
from .refocusing import Refocusing, refocus_field, svfg
from .resolving import LineContrast, Resolved, bars_field, resolve
from .retrieval import Recorded, Retrieved, agreement, retrieve
from .scenes import patch_scene
from .sensor import (
    Electronics,
    FootprintWarning,
    SaturationWarning,
    estimate_intensity,
    plane_seeds,
    record,
    sensor_grid,
)
from .slices import AnnularSlices
from .targets import (
    band_limit,
    phase_target,
    picture_target,
    siemens_star,
)
from .thin_lens import ThinLens
from .tilted_planes import from_tilted_plane, to_tilted_plane
from .usaf import usaf_chart, usaf_elements, usaf_elements_within, usaf_line_width_um
from .wave_propagation import WavePropagation
from .working_grid import TotalReflectionWarning

__all__ = [
    "AnnularSlices",
    "Choice",
    "Cost",
    "EikonalTiles",
    "Electronics",
    "Engine",
    "Field",
    "FoldError",
    "FootprintWarning",
    "Frame",
    "FrameSettings",
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
    "Reconstructed",
    "ReconstructionPupil",
    "Recorded",
    "Refocused",
    "Refocusing",
    "Resolved",
    "Retrieved",
    "SamplingWarning",
    "SaturationWarning",
    "Scene",
    "ThinLens",
    "TotalReflectionWarning",
    "WavePropagation",
    "agreement",
    "band_limit",
    "bars_field",
    "check_propagation",
    "choose",
    "chosen_engine",
    "correlation",
    "critical_distance_mm",
    "estimate_intensity",
    "field_stop",
    "from_tilted_plane",
    "gaussian_beam",
    "line_pair_contrast",
    "line_pair_displacement_um",
    "line_pair_image",
    "line_pair_profile",
    "make_engine",
    "measured_field",
    "mtf",
    "oracle_case",
    "patch_scene",
    "phase_target",
    "picture_target",
    "plane_seeds",
    "plane_wave",
    "predict",
    "predicted_relative_error",
    "propagate",
    "propagate_adjoint",
    "propagate_to",
    "propagate_to_adjoint",
    "prox_tv",
    "psf",
    "read_frame",
    "reconstruct",
    "record",
    "refocus",
    "refocus_field",
    "relative_error",
    "remove_shift",
    "resolve",
    "retrieve",
    "rms_waves",
    "run_oracle",
    "sensor_grid",
    "siemens_star",
    "smallest_resolved_line_width_um",
    "strehl",
    "svfg",
    "tissue_phantom",
    "to_tilted_plane",
    "usaf_chart",
    "usaf_elements",
    "usaf_elements_within",
    "usaf_line_width_um",
    "write_frame",
]

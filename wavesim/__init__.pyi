from .calibration.estimation import (
    Calibrated,
    calibrate,
)
from .calibration.from_frames import calibrate_frames
from .camera.exposures import (
    Electronics,
    SaturationWarning,
    estimate_intensity,
    merged_intensity,
    plane_seeds,
)
from .camera.frame_sets import (
    read_frames,
    recorded_planes,
)
from .camera.frames import Frame, FrameSettings, read_frame, write_frame
from .camera.imaging import Imaged, image
from .camera.mounting import (
    Mounting,
    read_mounting,
)
from .camera.recorded import Recorded, recorded_intensity
from .camera.recording import Recording, image_patch
from .camera.sensor import (
    FootprintWarning,
    record,
    record_exposures,
    sensor_grid,
)
from .camera.windows import (
    DiversityWarning,
    diversity,
    exit_scene,
    sensor_window,
)
from .engines.choosing import Choice, Prediction, choose, engine_for, predict
from .engines.no_lens import NoLens
from .engines.slices.engine import AnnularSlices
from .engines.surfaces.grids import TotalReflectionWarning
from .engines.thin_lens import ThinLens
from .engines.tiles.engine import EikonalTiles
from .engines.wpm.engine import WavePropagation
from .evaluation.accuracy import OracleResult, run_oracle
from .evaluation.metrics import (
    ElementContrast,
    as_passed,
    bar_contrast,
    element_contrasts,
    object_correlation,
    resolved_elements,
    smallest_resolved_element,
)
from .evaluation.resolving import LineContrast, Resolved, bars_field, resolve
from .evaluation.similarity import psnr_db, ssim
from .fields.field import Field, Grid, correlation, relative_error
from .fields.guards import (
    SamplingWarning,
    check_propagation,
    critical_distance_mm,
    predicted_relative_error,
)
from .fields.passage import Passage, propagate
from .fields.spectrum import SpectrumSupport, spectrum_support
from .objects.illumination import field_stop, gaussian_beam, measured_field, plane_wave
from .objects.patch import (
    Patch,
    Target,
    make_illumination,
    make_target,
    object_patch,
    usaf_charts_of,
    usaf_elements_of,
)
from .objects.phantom import tissue_phantom
from .objects.targets import (
    band_limit,
    phase_target,
    picture_target,
    siemens_star,
)
from .objects.usaf import usaf_chart, usaf_elements, usaf_elements_within, usaf_line_width_um
from .oracles.registry import OracleCase, oracle_case
from .pictures.layers import PictureLayer, field_layers, frame_layer
from .pictures.page import write_zoom_page
from .pictures.pyramid import write_pyramid
from .pupil.characteristic import PointCharacteristic, PupilSampler
from .pupil.line_pairs import (
    line_pair_contrast,
    line_pair_displacement_um,
    line_pair_image,
    line_pair_profile,
    smallest_resolved_line_width_um,
)
from .pupil.patch_chain import PatchChain, chain_contrast
from .pupil.pupil import (
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
from .pupil.ray_aiming import RayAimError
from .rays.ray_bundles import FoldError
from .reconstruction.bootstrap import uncertainty
from .reconstruction.found import FoundObject
from .reconstruction.from_field import Retrieved, agreement, retrieval_bytes, retrieve
from .reconstruction.from_frames import reconstruct_frames
from .reconstruction.from_object import Reconstructed, prox_tv, reconstruct
from .reconstruction.memory import reconstruction_bytes
from .reconstruction.refocusing import Refocusing, refocus_field, svfg
from .runtime.scratch import Scratch
from .scene.engine import Cost, Engine, Neglected
from .scene.patches import patch_scene
from .scene.scene import Scene

__all__ = [
    "AnnularSlices",
    "Calibrated",
    "Choice",
    "Cost",
    "DiversityWarning",
    "EikonalTiles",
    "Electronics",
    "ElementContrast",
    "Engine",
    "Field",
    "FoldError",
    "FootprintWarning",
    "FoundObject",
    "Frame",
    "FrameSettings",
    "Grid",
    "Imaged",
    "LineContrast",
    "Mounting",
    "Neglected",
    "NoLens",
    "OracleCase",
    "OracleResult",
    "Passage",
    "Patch",
    "PatchChain",
    "PictureLayer",
    "PointCharacteristic",
    "Prediction",
    "PupilGrid",
    "PupilSampler",
    "RayAimError",
    "Reconstructed",
    "ReconstructionPupil",
    "Recorded",
    "Recording",
    "Refocused",
    "Refocusing",
    "Resolved",
    "Retrieved",
    "SamplingWarning",
    "SaturationWarning",
    "Scene",
    "Scratch",
    "SpectrumSupport",
    "Target",
    "ThinLens",
    "TotalReflectionWarning",
    "WavePropagation",
    "agreement",
    "as_passed",
    "band_limit",
    "bar_contrast",
    "bars_field",
    "calibrate",
    "calibrate_frames",
    "chain_contrast",
    "check_propagation",
    "choose",
    "correlation",
    "critical_distance_mm",
    "diversity",
    "element_contrasts",
    "engine_for",
    "estimate_intensity",
    "exit_scene",
    "field_layers",
    "field_stop",
    "frame_layer",
    "gaussian_beam",
    "image",
    "image_patch",
    "line_pair_contrast",
    "line_pair_displacement_um",
    "line_pair_image",
    "line_pair_profile",
    "make_illumination",
    "make_target",
    "measured_field",
    "merged_intensity",
    "mtf",
    "object_correlation",
    "object_patch",
    "oracle_case",
    "patch_scene",
    "phase_target",
    "picture_target",
    "plane_seeds",
    "plane_wave",
    "predict",
    "predicted_relative_error",
    "propagate",
    "prox_tv",
    "psf",
    "psnr_db",
    "read_frame",
    "read_frames",
    "read_mounting",
    "reconstruct",
    "reconstruct_frames",
    "reconstruction_bytes",
    "record",
    "record_exposures",
    "recorded_intensity",
    "recorded_planes",
    "refocus",
    "refocus_field",
    "relative_error",
    "remove_shift",
    "resolve",
    "resolved_elements",
    "retrieval_bytes",
    "retrieve",
    "rms_waves",
    "run_oracle",
    "sensor_grid",
    "sensor_window",
    "siemens_star",
    "smallest_resolved_element",
    "smallest_resolved_line_width_um",
    "spectrum_support",
    "ssim",
    "strehl",
    "svfg",
    "tissue_phantom",
    "uncertainty",
    "usaf_chart",
    "usaf_charts_of",
    "usaf_elements",
    "usaf_elements_of",
    "usaf_elements_within",
    "usaf_line_width_um",
    "write_frame",
    "write_pyramid",
    "write_zoom_page",
]

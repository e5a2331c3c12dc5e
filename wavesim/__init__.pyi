from .calibration.calibration_result import Calibrated
from .calibration.frame_calibration import calibrate_frames
from .engines.choosing import choose, engine_for
from .fields.field import Field, Grid
from .fields.propagator import propagate
from .fields.sampling_checks import SamplingWarning
from .metrics.resolving import resolve
from .plots.page import write_zoom_page
from .plots.pyramid import write_pyramid
from .pupil.characteristic import PupilSampler
from .pupil.line_pairs import line_pair_contrast
from .pupil.patch_reconstructor import PatchReconstructor
from .pupil.pupil import ReconstructionPupil, mtf, psf, refocus, rms_waves, strehl
from .reconstruction.colours import FoundColours, reconstruct_colours
from .reconstruction.found_object import FoundObject
from .reconstruction.frame_reconstruction import reconstruct_frames
from .reconstruction.layer_reconstruction import FoundLayers, reconstruct_layers
from .reconstruction.object_solver import reconstruct
from .reconstruction.phase_retrieval import retrieve
from .reconstruction.refocusing import refocus_field
from .scene.engine import Engine
from .scene.patches import patch_scene
from .scene.scene import Scene
from .scene.settings import ImageSettings, ReconstructionSettings
from .scene.state_files import read_state, write_state
from .scene.system_state import SystemState
from .sensor.camera_noise import Electronics
from .sensor.frame_sets import read_colour_frames, read_frames
from .sensor.frames import Frame, FrameSettings, write_frame
from .sensor.imaging import Imaged, image
from .sensor.measurement import Measurement
from .targets.usaf import usaf_chart

__all__ = [
    "Calibrated",
    "Electronics",
    "Engine",
    "Field",
    "FoundColours",
    "FoundLayers",
    "FoundObject",
    "Frame",
    "FrameSettings",
    "Grid",
    "ImageSettings",
    "Imaged",
    "Measurement",
    "PatchReconstructor",
    "PupilSampler",
    "ReconstructionPupil",
    "ReconstructionSettings",
    "SamplingWarning",
    "Scene",
    "SystemState",
    "calibrate_frames",
    "choose",
    "engine_for",
    "image",
    "line_pair_contrast",
    "mtf",
    "patch_scene",
    "propagate",
    "psf",
    "read_colour_frames",
    "read_frames",
    "read_state",
    "reconstruct",
    "reconstruct_colours",
    "reconstruct_frames",
    "reconstruct_layers",
    "refocus",
    "refocus_field",
    "resolve",
    "retrieve",
    "rms_waves",
    "strehl",
    "usaf_chart",
    "write_frame",
    "write_pyramid",
    "write_state",
    "write_zoom_page",
]

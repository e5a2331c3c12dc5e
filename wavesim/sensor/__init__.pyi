from .camera_noise import Electronics, SaturationWarning, plane_seeds
from .colour_filters import ColourFilters
from .frame_sets import read_colour_frames, read_frames, recorded_planes
from .frames import Frame, FrameSettings, read_frame, write_frame
from .imaging import Imaged, image
from .measurement import Measurement, recorded_intensity
from .merged_exposures import estimate_intensity, merged_intensity
from .recording import Recorder, Recording, drop_parts
from .sensor import Camera, FootprintWarning, interference_on_pixels, light_on_pixels, sensor_grid
from .windows import DiversityWarning, diversity, exit_scene, sensor_window

__all__ = [
    "Camera",
    "ColourFilters",
    "DiversityWarning",
    "Electronics",
    "FootprintWarning",
    "Frame",
    "FrameSettings",
    "Imaged",
    "Measurement",
    "Recorder",
    "Recording",
    "SaturationWarning",
    "diversity",
    "drop_parts",
    "estimate_intensity",
    "exit_scene",
    "image",
    "interference_on_pixels",
    "light_on_pixels",
    "merged_intensity",
    "plane_seeds",
    "read_colour_frames",
    "read_frame",
    "read_frames",
    "recorded_intensity",
    "recorded_planes",
    "sensor_grid",
    "sensor_window",
    "write_frame",
]

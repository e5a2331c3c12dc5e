from .bench import Bench, LightErrors
from .engine import Cost, Engine, ErrorTerm, Tiled
from .light import Light
from .patches import patch_scene
from .placement import Placement
from .scene import Scene, placed_scene
from .settings import (
    CalibrationSettings,
    FrameSetSettings,
    ImageSettings,
    ReconstructionSettings,
    SettingError,
)

__all__ = [
    "Bench",
    "CalibrationSettings",
    "Cost",
    "Engine",
    "ErrorTerm",
    "FrameSetSettings",
    "ImageSettings",
    "Light",
    "LightErrors",
    "Placement",
    "ReconstructionSettings",
    "Scene",
    "SettingError",
    "Tiled",
    "patch_scene",
    "placed_scene",
]

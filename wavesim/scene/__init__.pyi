from .bench import Bench, LightErrors
from .engine import Cost, Engine, Neglected, Tiled
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
    "FrameSetSettings",
    "ImageSettings",
    "Light",
    "LightErrors",
    "Neglected",
    "Placement",
    "ReconstructionSettings",
    "Scene",
    "SettingError",
    "Tiled",
    "patch_scene",
    "placed_scene",
]

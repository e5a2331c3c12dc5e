from .engine import Cost, Engine, Neglected
from .patches import patch_scene
from .scene import Scene
from .settings import (
    CalibrationSettings,
    FrameSetSettings,
    ImageSettings,
    ReconstructionSettings,
    SettingError,
)

__all__ = [
    "CalibrationSettings",
    "Cost",
    "Engine",
    "FrameSetSettings",
    "ImageSettings",
    "Neglected",
    "ReconstructionSettings",
    "Scene",
    "SettingError",
    "patch_scene",
]

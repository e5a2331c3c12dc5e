from .engine import Cost, Engine, ErrorTerm, Tiled
from .light_errors import LightErrors
from .patches import patch_scene
from .scattered_light import Light
from .scene import Scene, placed_scene
from .settings import (
    CalibrationSettings,
    FrameSetSettings,
    ImageSettings,
    ReconstructionSettings,
    SettingError,
)
from .state_files import read_state, write_state
from .system_state import SystemState

__all__ = [
    "CalibrationSettings",
    "Cost",
    "Engine",
    "ErrorTerm",
    "FrameSetSettings",
    "ImageSettings",
    "Light",
    "LightErrors",
    "ReconstructionSettings",
    "Scene",
    "SettingError",
    "SystemState",
    "Tiled",
    "patch_scene",
    "placed_scene",
    "read_state",
    "write_state",
]

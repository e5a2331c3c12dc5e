from .choosing import Choice, Prediction, choose, engine_for, predict
from .eikonal.engine import EikonalEngine
from .no_lens import NoLens
from .slices.engine import AnnularSlices
from .surfaces.grids import TotalReflectionWarning
from .thin_lens import ThinLens
from .with_ghost import WithGhost
from .wpm.engine import WavePropagation

__all__ = [
    "AnnularSlices",
    "Choice",
    "EikonalEngine",
    "NoLens",
    "Prediction",
    "ThinLens",
    "TotalReflectionWarning",
    "WavePropagation",
    "WithGhost",
    "choose",
    "engine_for",
    "predict",
]

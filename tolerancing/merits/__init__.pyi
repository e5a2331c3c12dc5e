from .base import Merit
from .compensators import Compensator
from .context import Context, Sampling
from .ghosts import GhostFraction
from .line_pairs import LinePairContrast
from .pupil import ImageShift, ModulationTransfer, PupilMerit, RmsWaves, SmallestResolvedLine, Strehl
from .python import PythonMerit, Trial
from .rays import FootprintRadius, LargestSpread, RayMerit, ScatteredFraction, Throughput, Transmittance
from .reconstructed_contrast import ReconstructedContrast
from .reconstruction_loss import ReconstructionLoss
from .registry import MERITS, merit_from_table

__all__ = [
    "MERITS",
    "Compensator",
    "Context",
    "FootprintRadius",
    "GhostFraction",
    "ImageShift",
    "LargestSpread",
    "LinePairContrast",
    "Merit",
    "ModulationTransfer",
    "PupilMerit",
    "PythonMerit",
    "RayMerit",
    "ReconstructedContrast",
    "ReconstructionLoss",
    "RmsWaves",
    "Sampling",
    "ScatteredFraction",
    "SmallestResolvedLine",
    "Strehl",
    "Throughput",
    "Transmittance",
    "Trial",
    "merit_from_table",
]

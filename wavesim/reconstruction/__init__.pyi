from .diagnostics.bootstrap import Uncertainty, UndeterminedError, uncertainty
from .found import FoundObject
from .from_field import Retrieved, agreement, retrieve
from .from_frames import reconstruct_frames
from .from_object import Reconstructed, prox_tv, reconstruct
from .memory import reconstruction_bytes, retrieval_bytes
from .refocusing import Refocusing, refocus_field, svfg

__all__ = [
    "FoundObject",
    "Reconstructed",
    "Refocusing",
    "Retrieved",
    "Uncertainty",
    "UndeterminedError",
    "agreement",
    "prox_tv",
    "reconstruct",
    "reconstruct_frames",
    "reconstruction_bytes",
    "refocus_field",
    "retrieval_bytes",
    "retrieve",
    "svfg",
    "uncertainty",
]

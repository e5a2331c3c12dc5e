from .diagnostics.bootstrap import Uncertainty, UndeterminedError, uncertainty
from .found_object import FoundObject
from .frame_reconstruction import reconstruct_frames
from .memory import reconstruction_bytes, retrieval_bytes
from .object_solver import Reconstructed, prox_tv, reconstruct
from .phase_retrieval import Retrieved, agreement, retrieve
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

from .diagnostics.bootstrap import Uncertainty, UndeterminedError, uncertainty
from .found_object import FoundObject
from .frame_reconstruction import reconstruct_frames
from .layer_reconstruction import FoundLayers, reconstruct_layers
from .layered import Layers, find_layers
from .memory import reconstruction_bytes, retrieval_bytes
from .object_solver import Reconstructed, prox_tv, reconstruct
from .phase_retrieval import Retrieved, agreement, retrieve
from .refocusing import Refocusing, refocus_field, svfg
from .retrieval_figures import convergence_figure, starts_figure

__all__ = [
    "FoundLayers",
    "FoundObject",
    "Layers",
    "Reconstructed",
    "Refocusing",
    "Retrieved",
    "Uncertainty",
    "UndeterminedError",
    "agreement",
    "convergence_figure",
    "find_layers",
    "prox_tv",
    "reconstruct",
    "reconstruct_frames",
    "reconstruct_layers",
    "reconstruction_bytes",
    "refocus_field",
    "retrieval_bytes",
    "retrieve",
    "starts_figure",
    "svfg",
    "uncertainty",
]

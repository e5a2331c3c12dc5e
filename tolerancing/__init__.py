"""Tolerancing of transfer lenses: perturb, repeat, store, report."""

from tolerancing.perturbations import PerturbationBatch, realise
from tolerancing.run import run_study
from tolerancing.store import Store, open_store
from tolerancing.study import LoadedStudy, Study, load_study

__all__ = [
    "LoadedStudy",
    "PerturbationBatch",
    "Store",
    "Study",
    "load_study",
    "open_store",
    "realise",
    "run_study",
]

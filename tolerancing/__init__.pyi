from .batch import PerturbationBatch, Realisation
from .evaluate import realise
from .report import write_report
from .run import run_study
from .store import Store, open_store
from .study import Study
from .study_files import LoadedStudy, load_study
from .summary import summarize

__all__ = [
    "LoadedStudy",
    "PerturbationBatch",
    "Realisation",
    "Store",
    "Study",
    "load_study",
    "open_store",
    "realise",
    "run_study",
    "summarize",
    "write_report",
]

from .perturbations import PerturbationBatch, realise
from .report import write_report
from .run import run_study
from .store import Store, open_store
from .study import LoadedStudy, Study, load_study
from .summary import summarize

__all__ = [
    "LoadedStudy",
    "PerturbationBatch",
    "Store",
    "Study",
    "load_study",
    "open_store",
    "realise",
    "run_study",
    "summarize",
    "write_report",
]

from .analysis.summary import summarize
from .perturbations.batch import PerturbationBatch, Realisation
from .report.report import write_report
from .run.run import run_study
from .store.store import Store, open_store
from .study.evaluate import realise
from .study.files import LoadedStudy, load_study
from .study.study import Study

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

"""Tolerancing of transfer lenses: perturb, repeat, store, report."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tolerancing.perturbations import PerturbationBatch, realise
    from tolerancing.report import write_report
    from tolerancing.run import run_study
    from tolerancing.store import Store, open_store
    from tolerancing.study import LoadedStudy, Study, load_study
    from tolerancing.summary import summarize

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

_MODULES = {
    "LoadedStudy": "study",
    "PerturbationBatch": "perturbations",
    "Store": "store",
    "Study": "study",
    "load_study": "study",
    "open_store": "store",
    "realise": "perturbations",
    "run_study": "run",
    "summarize": "summary",
    "write_report": "report",
}


def __getattr__(name: str) -> Any:
    """Import a public name where it is first used: the command must be able to go before NumPy."""
    if name in _MODULES:
        return getattr(import_module(f"tolerancing.{_MODULES[name]}"), name)
    raise AttributeError(f"module 'tolerancing' has no attribute {name!r}")

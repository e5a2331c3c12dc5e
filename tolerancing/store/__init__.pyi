from .creation import create_store
from .export import write_steps, write_trials
from .schema import MeritRecord, StudyRecord
from .store import Store, open_store

__all__ = [
    "MeritRecord",
    "Store",
    "StudyRecord",
    "create_store",
    "open_store",
    "write_steps",
    "write_trials",
]

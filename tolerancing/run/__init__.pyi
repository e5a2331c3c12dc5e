from .executors import RunError
from .run import RunOutcome, run_study

__all__ = [
    "RunError",
    "RunOutcome",
    "run_study",
]

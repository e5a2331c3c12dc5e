from .memory import MemoryLimitError
from .scratch import Scratch

__all__ = [
    "MemoryLimitError",
    "Scratch",
]

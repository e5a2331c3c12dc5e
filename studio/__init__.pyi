from .model.bench import Workbench
from .page.notebook import studio

__all__ = [
    "Workbench",
    "studio",
]

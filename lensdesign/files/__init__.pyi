from .codev import read_seq, write_seq
from .design import design_text, load_design, save_design
from .draft import Imported, LossyImportError, Supplement
from .figures import read_figure_grid, surface_figure, write_figure_grid
from .zemax import read_zmx, write_zmx

__all__ = [
    "Imported",
    "LossyImportError",
    "Supplement",
    "design_text",
    "load_design",
    "read_figure_grid",
    "read_seq",
    "read_zmx",
    "save_design",
    "surface_figure",
    "write_figure_grid",
    "write_seq",
    "write_zmx",
]

from .codev import read_seq, write_seq
from .design import design_text, load_design, save_design
from .draft import Imported, LossyImportError, Supplement
from .figures import read_figure_grid, surface_figure, write_figure_grid
from .formats import LensFormat, read_lens_file, write_lens_file
from .zemax import read_zmx, write_zmx

__all__ = [
    "Imported",
    "LensFormat",
    "LossyImportError",
    "Supplement",
    "design_text",
    "load_design",
    "read_figure_grid",
    "read_lens_file",
    "read_seq",
    "read_zmx",
    "save_design",
    "surface_figure",
    "write_figure_grid",
    "write_lens_file",
    "write_seq",
    "write_zmx",
]

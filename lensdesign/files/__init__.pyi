from .codev import read_seq, write_seq
from .design import design_text, load_design, save_design
from .draft import Imported, LossyImportError, Supplement
from .formats import LensFormat, read_lens_file, write_lens_file
from .interferograms import FigureMap, Interferogram, figure_map, read_interferogram
from .oslo import read_len
from .surface_figures import read_surface_figure_grid, surface_figure, write_surface_figure_grid
from .zemax import read_zmx, write_zmx

__all__ = [
    "FigureMap",
    "Imported",
    "Interferogram",
    "LensFormat",
    "LossyImportError",
    "Supplement",
    "design_text",
    "figure_map",
    "load_design",
    "read_interferogram",
    "read_len",
    "read_lens_file",
    "read_seq",
    "read_surface_figure_grid",
    "read_zmx",
    "save_design",
    "surface_figure",
    "write_lens_file",
    "write_seq",
    "write_surface_figure_grid",
    "write_zmx",
]

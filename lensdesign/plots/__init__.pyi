from .glb import write_scene
from .page import write_view
from .plots import draw_all
from .window import open_window

__all__ = [
    "draw_all",
    "open_window",
    "write_scene",
    "write_view",
]

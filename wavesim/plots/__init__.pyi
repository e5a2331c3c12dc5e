from .frames import curves_figure, frames_figure, residual_figure
from .layers import PictureLayer, field_layers, frame_layer
from .objects import object_figure
from .page import write_zoom_page
from .pyramid import write_pyramid

__all__ = [
    "PictureLayer",
    "curves_figure",
    "field_layers",
    "frame_layer",
    "frames_figure",
    "object_figure",
    "residual_figure",
    "write_pyramid",
    "write_zoom_page",
]

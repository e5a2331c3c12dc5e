"""Figures as picture files."""

from __future__ import annotations

from typing import IO, TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.figure import Figure

COMPRESSION = 3
"""Of PNG: files get hardly smaller by more, noise even larger, in twice the time."""


def save_figure(
    figure: Figure, path: Path | IO[bytes], form: str, dots_per_inch: int, **options: Any
) -> None:
    """Write a figure as ``figure.savefig`` does; a PNG in half of its time, with the same dots.

    Matplotlib lays a figure out twice and draws it twice, the first time for nothing, and packs a channel of
    opacity that is 1 everywhere.

    Parameters
    ----------
    figure
        Opaque.
    path
        File to write, whatever its suffix, or one that is open.
    form
        "png", or another that Matplotlib knows.
    dots_per_inch
        Of pictures of dots.
    **options
        Of ``savefig``, for other forms.
    """
    if form != "png":
        figure.savefig(path, format=form, dpi=dots_per_inch, **options)
        return
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from PIL import Image

    before, layout = figure.dpi, figure.get_layout_engine()
    try:
        figure.dpi = dots_per_inch
        agg = FigureCanvasAgg(figure)
        if layout is not None:
            layout.execute(figure)
            figure.set_layout_engine("none")
        agg.draw()
        picture = Image.frombuffer("RGBA", agg.get_width_height(), agg.buffer_rgba()).convert("RGB")
    finally:
        figure.dpi = before
        figure.set_layout_engine(layout)
    picture.save(path, "PNG", compress_level=COMPRESSION, dpi=(dots_per_inch, dots_per_inch))

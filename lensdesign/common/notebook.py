"""Representation of results in notebooks and on HTML pages."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from typing import TYPE_CHECKING, Any

from lensdesign.common.text import visible

if TYPE_CHECKING:
    from jinja2 import Template
    from numpy.typing import NDArray


MOST_PIXELS = 200
"""Largest number of pixels of the longer side of a picture."""


def html_table(title: str, rows: Sequence[tuple[str, str]], picture: str = "") -> str:
    """Return a titled table of names and values as HTML, for a ``_repr_html_``.

    Parameters
    ----------
    title
        Title above the table; empty for none.
    rows
        Name and value of each row as text.
    picture
        Markup below the table, such as an SVG element; it is the only part that is not escaped.
    """
    heading = f"<caption>{escape(visible(title))}</caption>" if title else ""
    lines = (
        f"<tr><th style='text-align:left'>{escape(visible(name))}</th>"
        f"<td style='text-align:left'>{escape(visible(value))}</td></tr>"
        for name, value in rows
    )
    return f"<table>{heading}{''.join(lines)}</table>{picture}"


def html_picture(values: NDArray[Any]) -> str:
    """Return a small grey-scale picture of moduli as an HTML image, for :func:`html_table`.

    Parameters
    ----------
    values : ndarray, shape (ny, nx)
        Values, real or complex. A modulus of 0 is black and the largest one white; the first row is at the
        bottom.
    """
    import base64
    import io

    import numpy as np
    from PIL import Image

    step = -(-max(values.shape) // MOST_PIXELS)
    shown = np.abs(values[::step, ::step])[::-1]
    grey = np.clip(255.0 * shown / max(float(shown.max()), 1e-300), 0.0, 255.0).astype(np.uint8)
    file = io.BytesIO()
    Image.fromarray(grey).save(file, "png")
    return f'<img src="data:image/png;base64,{base64.b64encode(file.getvalue()).decode()}">'


def page_template(package: str, name: str, **options: Any) -> Template:
    """Return a page's template from the folder `templates` of a package; `options` are those of jinja."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    return Environment(
        loader=PackageLoader(package),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        **options,
    ).get_template(name)

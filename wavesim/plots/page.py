"""Pictures of a whole field as one self-contained page for a browser, which zooms.

The page contains each picture as tiles of 8 bits, with each level half the size of the previous one, and
draws the tiles that the screen shows. A sample of a tile is 0 where there is no value, and 1 to 255 from the
low to the high end of the layer's range.
"""

from __future__ import annotations

import base64
import io
import math
import os
import zlib
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from lensdesign.common.atomic_files import atomic_path
from lensdesign.common.notebook import page_template
from lensdesign.errors import InputError
from wavesim.plots.layers import PictureLayer
from wavesim.plots.pyramid import TILE

STEPS = 254
"""Number of grey levels in a layer's range."""

MARK = "<!-- tiles -->"
"""Position of the tiles in the template; they are written one by one."""


@dataclass(frozen=True)
class ZoomSummary:
    """Content of a page.

    Attributes
    ----------
    layers : tuple of str
        Names of the pictures.
    tiles, bytes : int
        Number of tiles, and size of the file.
    halvings : tuple of int
        Number of halvings of each layer's finest level in the page; 0 if it shows every sample.
    region_mm : float or None
        Side of a square region that fits with every sample; None if nothing was left out.
    """

    layers: tuple[str, ...]
    tiles: int
    bytes: int
    halvings: tuple[int, ...]
    region_mm: float | None

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return asdict(self)


Tiles = dict[tuple[int, int], list[str]]
"""Tiles in base 64, by layer index and number of halvings."""


def write_zoom_page(
    layers: Sequence[PictureLayer],
    path: str | os.PathLike[str],
    title: str = "",
    facts: Sequence[tuple[str, str]] = (),
    most_bytes: int = 100_000_000,
) -> ZoomSummary:
    """Write a self-contained HTML page that shows pictures and zooms into them.

    Parameters
    ----------
    layers
        Pictures, one or more, between which the reader switches. :func:`wavesim.plots.field_layers` and
        :func:`wavesim.plots.frame_layer` make them.
    path
        File to write, with the suffix .html.
    title
        Title of the page.
    facts
        Names and values of a table beside the pictures.
    most_bytes
        Largest total size of the tiles. If they need more, the page omits the finest levels of all layers.

    Returns
    -------
    ZoomSummary
        Names of the layers, number of tiles, size of the file, and the levels that the page contains.

    Raises
    ------
    InputError
        If there is no layer, the suffix is not .html, or the file cannot be written.

    Examples
    --------
    >>> import numpy as np
    >>> from wavesim import write_zoom_page
    >>> from wavesim.plots import field_layers
    >>> wave = np.exp(1j * np.linspace(0.0, 6.0, 300 * 400).reshape(300, 400))
    >>> page = write_zoom_page(field_layers(wave, pitch_um=0.5), folder / "wave.html", "A wave")  # any folder
    >>> page.layers, page.tiles
    (('amplitude', 'phase'), 2)
    """
    if Path(path).suffix.lower() != ".html":
        raise InputError(f"cannot write {path}: the file name must end in .html")
    if not layers:
        raise InputError("a page needs at least one layer")
    tiles = _tiles(layers, most_bytes)
    texts: list[str] = []
    descriptions = [_layer(layer, number, tiles, texts) for number, layer in enumerate(layers)]
    head, tail = _page(title or "Field", facts, descriptions).split(MARK)
    with atomic_path(path) as temporary:
        with temporary.open("w", encoding="utf-8", newline="\n") as file:
            file.write(head)
            file.writelines("\n" + text if number else text for number, text in enumerate(texts))
            file.write(tail)
        size = temporary.stat().st_size
    names, finest = (
        tuple(layer.name for layer in layers),
        tuple(e["levels"][0]["halvings"] for e in descriptions),
    )
    region_mm = _region_mm(layers, tiles, most_bytes) if any(finest) else None
    return ZoomSummary(names, len(texts), size, finest, region_mm)


def _tiles(layers: Sequence[PictureLayer], most_bytes: int) -> Tiles:
    """Return tiles of small levels before those of large ones, up to the allowed size."""
    found: Tiles = {}
    order = sorted(
        (math.prod(level.shape), number, halvings)
        for number, layer in enumerate(layers)
        for halvings, level in enumerate(layer.levels)
    )
    total = 0
    for _, number, halvings in order:
        layer, made = layers[number], []
        for values in layer.levels[halvings].tiles():
            made.append(_png(_quantised(values, layer)))
            total += len(made[-1])
            if total > most_bytes and halvings < len(layer.levels) - 1:
                return found
        found[number, halvings] = made
    return found


def _quantised(values: Any, layer: PictureLayer) -> Any:
    """Return the values as grey levels of 8 bits."""
    values = np.asarray(values, np.float32)
    low, high = layer.low, layer.high
    if layer.logarithmic:
        values, low, high = np.log(np.maximum(values, low)), math.log(low), math.log(high)
    known = ~np.isnan(values)
    fraction = np.clip((np.where(known, values, low) - low) / (high - low), 0.0, 1.0)
    return np.where(known, 1.0 + np.round(STEPS * fraction), 0.0).astype(np.uint8)


def _png(levels: Any) -> str:
    from PIL import Image

    buffer = io.BytesIO()
    # For noise, run-length encoding gives files as small as longer searches, in a third of the time.
    picture = Image.fromarray(np.ascontiguousarray(levels))
    picture.save(buffer, format="PNG", compress_level=1, compress_type=zlib.Z_RLE)
    return base64.b64encode(buffer.getvalue()).decode("ascii")


def _layer(layer: PictureLayer, number: int, tiles: Tiles, texts: list[str]) -> dict[str, Any]:
    """Return the description of a layer for the page, and append its tiles to `texts`."""
    rows, columns = layer.levels[0].shape
    levels = []
    for halvings, level in enumerate(layer.levels):
        if (number, halvings) not in tiles:
            continue
        levels.append({"halvings": halvings, "size": level.shape[::-1], "first": len(texts)})
        texts += tiles[number, halvings]
    x_um, y_um = layer.centre_um
    return {
        "name": layer.name,
        "unit": layer.unit,
        "plane": layer.plane,
        "pitch": layer.pitch_um,
        "left": x_um - 0.5 * columns * layer.pitch_um,
        "top": y_um + 0.5 * rows * layer.pitch_um,
        "size": [columns, rows],
        "low": layer.low,
        "high": layer.high,
        "beyond": layer.beyond,
        "logarithmic": layer.logarithmic,
        "palette": _palette(layer.colours),
        "levels": levels,
    }


def _palette(colours: str) -> str:
    """Return red, green and blue of the levels 1 to 255, in base 64."""
    from matplotlib import colormaps

    colour_map = colormaps[colours].resampled(STEPS + 1)
    rgb = np.round(255.0 * colour_map(np.linspace(0.0, 1.0, STEPS + 1))[:, :3]).astype(np.uint8)
    return base64.b64encode(rgb.tobytes()).decode("ascii")


def _region_mm(layers: Sequence[PictureLayer], tiles: Tiles, most_bytes: int) -> float:
    """Return the side of a central square that should fit with all its levels, to two digits."""
    first = layers[0]
    of_a_sample = sum(
        _bytes_per_sample(layer, number, tiles)
        for number, layer in enumerate(layers)
        if layer.plane == first.plane
    )
    # The coarser levels add a third (1/4 + 1/16 + ...). The factor 1.2 is a margin.
    side = 1e-3 * first.pitch_um * math.sqrt(most_bytes / (1.2 * 4.0 / 3.0 * of_a_sample))
    unit = 10.0 ** (math.floor(math.log10(side)) - 1)
    whole = 1e-3 * first.pitch_um * min(first.levels[0].shape)
    return min(float(f"{math.floor(side / unit) * unit:.2g}"), whole)


def _bytes_per_sample(layer: PictureLayer, number: int, tiles: Tiles) -> float:
    """Estimate the bytes of a sample from a tile in the middle and from the finest level in the page."""
    finest = layer.levels[0]
    rows, columns = (slice(max(0, (n - TILE) // 2), (n + TILE) // 2) for n in finest.shape)
    middle = finest.shown(finest.stored[rows, columns])
    halvings = min(h for n, h in tiles if n == number)
    coarser = sum(map(len, tiles[number, halvings])) / math.prod(layer.levels[halvings].shape)
    return max(len(_png(_quantised(middle, layer))) / middle.size, coarser)


def _page(title: str, facts: Sequence[tuple[str, str]], layers: Sequence[Any]) -> str:
    return page_template("wavesim.plots", "zoom.html.j2").render(
        title=title,
        facts=facts,
        planes=[
            (plane, [(i, layer) for i, layer in enumerate(layers) if layer["plane"] == plane])
            for plane in dict.fromkeys(layer["plane"] for layer in layers)
        ],
        page={"tile": TILE, "steps": STEPS, "layers": layers},
        mark=MARK,
    )

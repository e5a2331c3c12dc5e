"""Where the names of things stand in a picture of the scene: above or below them, clear of the glass.

The page for browsers does the same as it turns (``placeNames`` in ``templates/view.js``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.plots.scene import ScenePart

CHARACTER, GAP = (0.56, 1.35), 0.25
"""Width and height of a character, and room about a label, as shares of the size of type."""


@dataclass(frozen=True)
class PlacedLabel:
    """A label in the scene.

    Attributes
    ----------
    part
        What it names.
    foot, end
        Points in mm: the highest of the part on the screen (or the lowest, where the label stands below), and
        the middle of the label's edge towards it. They differ where the label had to move on.
    """

    part: ScenePart
    foot: Array
    end: Array


def placed_labels(parts: Sequence[ScenePart], screen: Array, type_mm: float) -> list[PlacedLabel]:
    """Labels of all but the rays, which touch neither each other nor the rectangles around the glass.

    Parameters
    ----------
    parts
        Of the scene.
    screen
        Unit vectors to the right and up on the screen, shape (2, 3).
    type_mm
        Size of type, in mm of the parallel projection.
    """
    width, height = CHARACTER
    named = [part for part in parts if part.kind != "rays"]
    flat = [part.vertices @ screen.T / type_mm for part in named]
    taken = [
        np.stack([at.min(axis=0), at.max(axis=0)])
        for part, at in zip(named, flat, strict=True)
        if part.kind == "glass"
    ]
    found = []
    for part, at in sorted(zip(named, flat, strict=True), key=lambda pair: pair[0].kind != "plane"):
        sign = -1.0 if part.label_below else 1.0
        place = int(np.argmax(sign * at[:, 1]))
        half = np.array([0.5 * width * len(part.label), 0.5 * height])
        middle = at[place] + [0.0, sign * (half[1] + GAP)]
        while blocks := [box for box in taken if np.all((box[0] < middle + half) & (middle - half < box[1]))]:
            edge = max(sign * box[(1 if sign > 0.0 else 0), 1] for box in blocks)
            middle[1] = sign * (edge + half[1] + GAP)
        taken.append(np.stack([middle - half, middle + half]))
        foot = part.vertices[place]
        rise = middle[1] - sign * half[1] - at[place, 1]
        found.append(PlacedLabel(part, foot, foot + type_mm * rise * screen[1]))
    return found

"""Placement of labels in a picture of the scene: above or below the objects, without covering the glass.

The page for browsers uses the same rules while it rotates (``placeNames`` in ``templates/view.js``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.plots.scene import ScenePart

CHARACTER, GAP = (0.56, 1.35), 0.25
"""Width and height of a character, and margin around a label, as fractions of the type size."""


@dataclass(frozen=True)
class PlacedLabel:
    """A label in the scene.

    Attributes
    ----------
    part
        The labelled object.
    foot, end
        Points in mm: the highest point of the object on the screen (the lowest for a label below), and the
        middle of the label's edge towards it. They differ if the label had to be moved.
    """

    part: ScenePart
    foot: Array
    end: Array


def placed_labels(parts: Sequence[ScenePart], screen: Array, type_mm: float) -> list[PlacedLabel]:
    """Return labels of all objects except rays, which overlap neither each other nor the glass.

    Parameters
    ----------
    parts
        Objects of the scene.
    screen
        Unit vectors to the right and up on the screen, shape (2, 3).
    type_mm
        Type size, in mm of the parallel projection.
    """
    width, height = CHARACTER
    named = [part for part in parts if part.kind != "rays"]
    flat = [part.vertices @ screen.T / type_mm for part in named]
    occupied = [
        np.stack([points.min(axis=0), points.max(axis=0)])
        for part, points in zip(named, flat, strict=True)
        if part.kind == "glass"
    ]
    found = []
    for part, points in sorted(zip(named, flat, strict=True), key=lambda pair: pair[0].kind != "plane"):
        sign = -1.0 if part.label_below else 1.0
        nearest = int(np.argmax(sign * points[:, 1]))
        half = np.array([0.5 * width * len(part.label), 0.5 * height])
        middle = points[nearest] + [0.0, sign * (half[1] + GAP)]
        while blocks := [
            box for box in occupied if np.all((box[0] < middle + half) & (middle - half < box[1]))
        ]:
            edge = max(sign * box[(1 if sign > 0.0 else 0), 1] for box in blocks)
            middle[1] = sign * (edge + half[1] + GAP)
        occupied.append(np.stack([middle - half, middle + half]))
        foot = part.vertices[nearest]
        rise = middle[1] - sign * half[1] - points[nearest, 1]
        found.append(PlacedLabel(part, foot, foot + type_mm * rise * screen[1]))
    return found

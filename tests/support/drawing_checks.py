"""Whether texts and lines of a drawing keep clear of each other."""

from __future__ import annotations

from typing import Any

import numpy as np

from lensdesign.fabrication.drawing.strokes import SHEET_MM, Drawing, Stroke


def overlapping(one: Any, other: Any) -> Any:
    """Pairs, as indices, of rectangles (left, bottom, right, top) that have a point inside in common."""
    a, b = np.array(one)[:, None], np.array(other)[None]
    return np.argwhere(np.all((a[..., :2] < b[..., 2:]) & (b[..., :2] < a[..., 2:]), axis=-1))


def assert_tidy(drawing: Drawing) -> None:
    """Texts and lines on the page, no text over another, nor over a line along x or y."""
    for sheet in drawing.sheets:
        texts, boxes = sheet.texts, np.array([text.box for text in sheet.texts])
        assert np.all((boxes > 0.0) & (boxes < [*SHEET_MM, *SHEET_MM]))
        assert min(text.size_mm for text in texts) >= 1.6
        for i, j in overlapping(boxes, boxes):
            assert i == j, (texts[i], texts[j])
        strokes = [item for item in sheet.items if isinstance(item, Stroke)]
        points = np.concatenate([stroke.points for stroke in strokes])
        assert np.all((points > 0.0) & (points < SHEET_MM))
        pairs = np.array([stroke.points for stroke in strokes if len(stroke.points) == 2])
        straight = pairs[np.any(pairs[:, 0] == pairs[:, 1], axis=-1)]
        lines = np.concatenate([straight.min(axis=1), straight.max(axis=1)], axis=-1)
        for i, j in overlapping(boxes, lines):
            raise AssertionError((texts[i], lines[j]))

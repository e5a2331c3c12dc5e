"""Names in the scene stand clear of the glass and of each other."""

from __future__ import annotations

import numpy as np
import pytest
from places import DESIGNS

from lensdesign import Lens, load_design
from lensdesign.plots.labels import CHARACTER, placed_labels
from lensdesign.plots.scene import scene_parts

ANGLES_DEG = ((-122.0, 20.0), (-90.0, 0.0), (180.0, 0.0), (-60.0, -35.0))


def screen(turn_deg: float, rise_deg: float) -> np.ndarray:
    """Right and up on the screen of the page's camera."""
    a, e = np.deg2rad([turn_deg, rise_deg])
    return np.array(
        [[np.cos(a), 0.0, -np.sin(a)], [-np.sin(a) * np.sin(e), np.cos(e), -np.cos(a) * np.sin(e)]]
    )


@pytest.mark.parametrize("design", ["paper_singlet", "moulded_pair", "phone_lens"])
def test_no_label_crosses_glass_or_another_label(design: str) -> None:
    lens: Lens = load_design(DESIGNS / f"{design}.toml")
    parts = scene_parts(lens, 20.0)
    type_mm = 0.06 * lens.sensor.size_mm[1]
    for seen in map(screen, *zip(*ANGLES_DEG, strict=True)):
        boxes = [
            np.stack([at.min(axis=0), at.max(axis=0)])
            for at in (part.vertices @ seen.T for part in parts if part.kind == "glass")
        ]
        labels = placed_labels(parts, seen, type_mm)
        assert [label.part.kind for label in labels].count("plane") == 2
        assert len(labels) == sum(part.kind != "rays" for part in parts)
        for label in labels:
            near = label.part.vertices @ seen.T
            foot, end = seen @ label.foot, seen @ label.end
            best = near[:, 1].min() if label.part.label_below else near[:, 1].max()
            assert foot[1] == pytest.approx(best)
            assert end[0] == pytest.approx(foot[0])
            half = 0.5 * CHARACTER[0] * type_mm * len(label.part.label)
            rows = sorted(
                [end[1], end[1] + (-1.0 if label.part.label_below else 1.0) * CHARACTER[1] * type_mm]
            )
            box = np.array([[end[0] - half, rows[0]], [end[0] + half, rows[1]]])
            assert not [b for b in boxes if np.all((b[0] < box[1] - 1e-9) & (box[0] < b[1] - 1e-9))]
            boxes.append(box)

"""Pictures of large frames and objects: drawn with fewer samples, at the same scale."""

from __future__ import annotations

import numpy as np
import pytest

from wavesim.camera.frames import Frame, FrameSettings
from wavesim.fields.field import Field, Grid
from wavesim.pictures.frames import MOST_DRAWN, frames_figure, object_figure


@pytest.mark.parametrize(("samples", "factor"), [(300, 1), (2 * MOST_DRAWN + 5, 3)])
def test_a_picture_has_no_more_samples_than_a_screen(samples: int, factor: int) -> None:
    grid = Grid((samples, samples), 1e-3, -1.0)
    values = np.linspace(0.2, 1.0, samples)[None].repeat(samples, axis=0)
    figure = object_figure(Field(grid, values, 0.532), np.ones(grid.shape, bool))
    axes = figure.axes[0]
    shown = axes.images[0].get_array()
    assert shown is not None
    assert shown.shape == (samples // factor,) * 2
    assert float(shown[0, 0]) == pytest.approx(values[0, :factor].mean())
    bar = next(line for line in axes.lines if line.get_linewidth() == 3.0)
    length_um = float(np.ptp(np.asarray(bar.get_xdata()))) * factor
    (text,) = (t.get_text() for t in axes.texts)
    assert text == (f"{length_um:g} µm" if length_um < 1000.0 else f"{1e-3 * length_um:g} mm")


def test_exposures_stand_beside_each_other_and_planes_below() -> None:
    settings = FrameSettings(
        pixel_pitch_um=3.2, plane_distance_mm=2.0, wavelength_um=0.5, exposure=4.0, bits=12,
        offset_counts=10.0, gain_electrons_per_count=2.0,
    )  # fmt: skip
    counts = np.full((12, 10), 100, np.uint16)
    frames = [
        Frame(counts, settings.model_copy(update={"plane_distance_mm": z, "exposure": exposure}))
        for z, exposures in ((2.0, (4.0, 120.0)), (22.0, (9.0,)))
        for exposure in exposures
    ]
    shown = [a.get_title() for a in frames_figure(frames).axes if a.get_visible() and a.get_title()]
    assert shown == [
        "2 mm behind the exit vertex, exposure 1 x",
        "2 mm behind the exit vertex, exposure 30 x",
        "22 mm behind the exit vertex, exposure 1 x",
    ]
    alone = [a.get_title() for a in frames_figure(frames[1:]).axes if a.get_title()]
    assert alone == ["2 mm behind the exit vertex", "22 mm behind the exit vertex"]


def test_a_title_keeps_its_lines_and_shows_what_else_is_in_it() -> None:
    grid = Grid((20, 20), 1e-3, -1.0)
    figure = object_figure(Field(grid, np.ones(grid.shape), 0.532), np.ones(grid.shape, bool), "one\ntw\x1bo")
    assert figure.get_suptitle() == "one\ntw\\x1bo"

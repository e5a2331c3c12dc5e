"""Figures of objects at several wavelengths, and of heights."""

from __future__ import annotations

import numpy as np

from wavesim.fields.field import Field, Grid
from wavesim.reconstruction.colour_figures import colours_figure, heights_figure
from wavesim.reconstruction.heights import Heights

GRID = Grid((12, 12), 1e-3, -1.0)
INSIDE = np.ones(GRID.shape, bool)


def titles(figure: object) -> list[str]:
    return [axes.get_title() for axes in figure.axes if axes.images]  # type: ignore[attr-defined]


def test_amplitudes_and_phases_have_a_panel_for_each_wavelength() -> None:
    fields = [Field(GRID, np.full(GRID.shape, 0.5 + 0.5j), one) for one in (0.45, 0.635)]
    assert titles(colours_figure(fields, INSIDE)) == ["found, 0.45 µm", "found, 0.635 µm"] * 2
    real = [Field(GRID, np.full(GRID.shape, 0.5), one) for one in (0.45, 0.635)]
    figure = colours_figure(real, INSIDE, truth=real)
    assert titles(figure)[0] == "true, 0.45 µm"
    assert len(titles(figure)) == 4


def test_heights_have_their_deviation_and_the_ambiguous_part() -> None:
    ambiguous = np.zeros(GRID.shape, bool)
    ambiguous[:3] = True
    heights = Heights(np.linspace(0.0, 1.0, 144).reshape(12, 12), np.full(GRID.shape, 2e-3), ambiguous)
    figure = heights_figure(heights, Field(GRID, np.ones(GRID.shape), 0.532), INSIDE)
    assert titles(figure) == ["height", "standard deviation", "ambiguous order (25 %)"]
    shown = [np.asarray(axes.images[0].get_array()) for axes in figure.axes if axes.images]
    assert np.allclose(shown[0], heights.height_um)
    assert np.allclose(shown[1], 2.0)

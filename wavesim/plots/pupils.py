"""Figures of a reconstruction pupil: wavefront, point spread, line pairs, modulation transfer."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, get_args

import numpy as np

from lensdesign.plots.style import BLUE, ORANGE, in_style, styled_figure
from wavesim.fields.field import Orientation
from wavesim.plots.panels import colour_bar, title_figure
from wavesim.pupil.line_pairs import (
    line_pair_contrast,
    line_pair_displacement_um,
    line_pair_image,
    line_pair_profile,
)
from wavesim.pupil.pupil import ReconstructionPupil, mtf, psf, rms_waves, strehl

if TYPE_CHECKING:
    from matplotlib.figure import Figure

ORIENTATIONS: tuple[Orientation, ...] = get_args(Orientation)
COLOURS = {"x": BLUE, "y": ORANGE}


@in_style
def pupil_figure(pupil: ReconstructionPupil, line_widths_um: Sequence[float], title: str = "") -> Figure:
    """Draw one sheet with the figures of a registered pupil.

    It shows the wavefront, the point spread function on a logarithmic scale, the modulation transfer
    function, and for each line width the picture of the line pairs with profiles across them.

    Parameters
    ----------
    pupil
        A registered pupil.
    line_widths_um
        Widths of the line pairs to show, at least one.
    title
        Title of the figure.

    Returns
    -------
    matplotlib.figure.Figure
        The figure, which is not attached to a window; save it with ``figure.savefig``.
    """
    columns = max(3, len(line_widths_um))
    figure = styled_figure(4.2 * columns, 10.6)
    title_figure(figure, title)
    grid = figure.add_gridspec(3, columns, height_ratios=(1.0, 1.0, 0.72))
    _draw_wavefront(figure, figure.add_subplot(grid[0, 0]), pupil)
    _draw_psf(figure, figure.add_subplot(grid[0, 1]), pupil)
    _draw_mtf(figure.add_subplot(grid[0, 2:]), pupil)
    for column, width in enumerate(line_widths_um):
        _draw_line_pairs(figure, figure.add_subplot(grid[1, column]), pupil, width)
        _draw_profiles(figure.add_subplot(grid[2, column]), pupil, width)
    return figure


def _draw_wavefront(figure: Figure, axes: Any, pupil: ReconstructionPupil) -> None:
    waves = np.where(pupil.valid_on_grid > 0.0, pupil.waves_on_grid, np.nan)
    limit = max(float(np.nanmax(np.abs(waves))), 1e-3)
    (x, y), half = pupil.grid.centre, pupil.grid.half_width
    extent = (x - half, x + half, y - half, y + half)
    picture = axes.imshow(waves, origin="lower", extent=extent, cmap="RdBu_r", vmin=-limit, vmax=limit)
    colour_bar(figure, picture, axes, "optical path difference (waves)")
    axes.set_title(f"Wavefront: {rms_waves(pupil):.4f} waves rms")
    axes.set(xlabel="direction cosine L at the object", ylabel="direction cosine M at the object")
    shown = 1.04 * half  # the pupil's rim does not touch the frame
    axes.set(xlim=(x - shown, x + shown), ylim=(y - shown, y + shown))


def _draw_psf(figure: Figure, axes: Any, pupil: ReconstructionPupil) -> None:
    airy_diameter_um = 1.22 * pupil.wavelength_um / pupil.grid.half_width
    half_width = min(4.0 * airy_diameter_um, 0.5 * pupil.grid.window_um)
    coordinates, intensity = psf(pupil, half_width, points=257)
    psf_decades = 4.0
    decades = np.log10(np.maximum(intensity, 10.0**-psf_decades))
    picture = axes.pcolormesh(
        coordinates, coordinates, decades, cmap="inferno", vmin=-psf_decades, vmax=0.0, rasterized=True
    )
    colour_bar(figure, picture, axes, "log10 of the intensity (0: peak of a perfect lens)")
    axes.set_title(f"PSF: Strehl ratio {strehl(pupil):.4f}")
    axes.set(xlabel="x (µm)", ylabel="y (µm)", aspect="equal")


def _draw_mtf(axes: Any, pupil: ReconstructionPupil) -> None:
    cut_off = 2e3 * pupil.grid.half_width / pupil.wavelength_um
    frequencies = np.linspace(0.0, cut_off, 201)
    perfect = ReconstructionPupil(pupil.grid, np.zeros_like(pupil.opd_mm), pupil.valid)
    axes.plot(frequencies, mtf(perfect, frequencies), color="0.6", lw=1.2, ls="--", label="perfect pupil")
    for orientation in ORIENTATIONS:
        values = mtf(pupil, frequencies, orientation)
        axes.plot(frequencies, values, color=COLOURS[orientation], lw=1.8, label=f"across {orientation}")
    axes.set_title("Modulation transfer function")
    axes.set(xlabel="spatial frequency at the object (lp/mm)", ylabel="modulation")
    axes.set(xlim=(0.0, cut_off), ylim=(0.0, 1.02))
    axes.grid(True)
    axes.legend()


def _draw_line_pairs(figure: Figure, axes: Any, pupil: ReconstructionPupil, width_um: float) -> None:
    coordinates, intensity = line_pair_image(pupil, width_um, points=301)
    picture = axes.pcolormesh(
        coordinates, coordinates, intensity, cmap="gray", vmin=0.0, vmax=intensity.max(), rasterized=True
    )
    colour_bar(figure, picture, axes, "intensity (1: large bright area)")
    axes.set_title(f"Lines of {width_um:g} µm across x")
    axes.set(xlabel="x (µm)", ylabel="y (µm)", aspect="equal")


def _draw_profiles(axes: Any, pupil: ReconstructionPupil, width_um: float) -> None:
    for bar in range(-4, 5, 2):
        axes.axvspan(width_um * (bar - 0.5), width_um * (bar + 0.5), color="0.91", lw=0, zorder=0)
    contrasts = []
    for orientation in ORIENTATIONS:
        coordinates, intensity = line_pair_profile(pupil, width_um, orientation)
        place = line_pair_displacement_um(pupil, width_um, orientation)
        contrasts.append(f"{orientation} {line_pair_contrast(pupil, width_um, orientation):.3f}")
        label = f"across {orientation}, displaced by {round(place, 3) + 0.0:.3f} µm"
        axes.plot(coordinates - place, intensity, color=COLOURS[orientation], lw=1.6, label=label)
    axes.set_title(f"Contrast: {', '.join(contrasts)}")
    axes.set(xlabel="distance from the centre of the imaged lines (µm)", ylabel="intensity")
    axes.set(xlim=(-6.0 * width_um, 6.0 * width_um), ylim=(0.0, 1.35 * axes.get_ylim()[1]))
    axes.legend(loc="upper center")

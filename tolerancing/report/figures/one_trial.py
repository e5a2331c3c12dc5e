"""Figure of one trial: path difference, point spread function and line pairs at each field point."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.common.text import visible
from lensdesign.errors import TransferLensError
from lensdesign.plots.style import styled_figure
from tolerancing.merits.line_pairs import LinePairContrast
from tolerancing.merits.pupil import PupilMerit
from tolerancing.report.figures.style import chart_style, figure_format, write_figure
from tolerancing.statistics.trial import SingleTrial
from tolerancing.study.series import line_pair_picture
from tolerancing.study.study import Study

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


POINTS = 161
"""Samples along each side of a picture."""


def trial_figure(trial: SingleTrial) -> Figure:
    """Draw path difference, point spread function and line pairs at each field point of the pupil merits.

    Parameters
    ----------
    trial
        The trial, from :func:`tolerancing.statistics.trial.single_trial`.

    Returns
    -------
    Figure
        A matplotlib figure with one row for each field point.

    Raises
    ------
    TransferLensError
        If no field point can be drawn.
    """
    pictured = _pictured(trial.study)
    rows: list[tuple[tuple[float, float], PupilMerit]] = list(pictured.items())
    with chart_style({"axes.grid": False, "axes.titleweight": "normal"}):
        figure = styled_figure(9.0, 2.9 * len(rows) + 0.4)
        title = f"Trial {trial.number} of {trial.study.title or trial.study.design}"
        figure.suptitle(visible(title), fontweight="bold", parse_math=False)
        axes = figure.subplots(len(rows), 3, squeeze=False)
        for row, (point, merit) in zip(axes, rows, strict=True):
            try:
                _draw_row(figure, row, trial, point, merit)
            except TransferLensError as error:
                for axis in row:
                    axis.set_axis_off()
                row[0].text(0.0, 0.5, visible(str(error)), wrap=True, fontsize=7.5, parse_math=False)
    return figure


def write_trial_figure(trial: SingleTrial, path: str | os.PathLike[str]) -> None:
    """Write a figure of one trial to a file.

    For each field point of the study, the figure shows the path difference over the reconstruction pupil, the
    point spread function, and an image of line pairs.

    Parameters
    ----------
    trial
        The trial, from :func:`tolerancing.single_trial`.
    path
        File to write; its suffix selects the format (png, svg or pdf).

    Raises
    ------
    InputError
        If the suffix is unknown, or the file cannot be written.

    Examples
    --------
    >>> from tolerancing import load_study, open_store, run_study, single_trial, write_trial_figure
    >>> loaded = load_study("designs/as_built_tolerances.toml")
    >>> outcome = run_study(loaded, "study.db", trials=50, workers=1)
    >>> with open_store("study.db") as store:
    ...     write_trial_figure(single_trial(store, 7), "trial_7.png")
    """
    figure_format(path)
    write_figure(trial_figure(trial), path)


def _pictured(study: Study) -> dict[tuple[float, float], PupilMerit]:
    """Return the field points of the pupil merits, each with a merit that has wavelength and line width."""
    found: dict[tuple[float, float], PupilMerit] = {}
    for merit in sorted(
        (m for m in study.all_merits if isinstance(m, PupilMerit)),
        key=lambda m: not isinstance(m, LinePairContrast),
    ):
        for point in merit.points:
            found.setdefault(point, merit)
    return found or {(0.0, 0.0): PupilMerit(kind="rms_waves", at_most=1.0)}


def _draw_row(
    figure: Figure, axes: Array, trial: SingleTrial, point: tuple[float, float], merit: PupilMerit
) -> None:
    from wavesim import psf, rms_waves, strehl

    (pupil,) = trial.context.pupils(trial.batch, point, merit.wavelength_um, merit.refocus, True)
    half = pupil.grid.half_width
    x, y = pupil.grid.centre
    shown = np.where(pupil.valid_on_grid > 0.0, pupil.waves_on_grid, np.nan)
    extent = (x - half, x + half, y - half, y + half)
    largest = max(float(np.nanmax(np.abs(shown))), 1e-3)  # A symmetric range makes zero white.
    image = axes[0].imshow(shown, cmap="RdBu_r", origin="lower", extent=extent, vmin=-largest, vmax=largest)
    figure.colorbar(image, ax=axes[0], shrink=0.8, label="waves")
    axes[0].set_title(f"({point[0]:g}, {point[1]:g}) mm: {rms_waves(pupil):.3f} waves rms", fontsize=8.0)
    axes[0].set_xlabel("direction cosine L")
    axes[0].set_ylabel("direction cosine M")
    width = min(6.0, 0.49 * pupil.grid.window_um)
    coordinates, spread = psf(pupil, width, POINTS)
    limits = (coordinates[0], coordinates[-1], coordinates[0], coordinates[-1])
    axes[1].imshow(np.sqrt(spread), cmap="magma", origin="lower", extent=limits, vmin=0.0)
    axes[1].set_title(f"point spread (amplitude), Strehl {strehl(pupil):.3f}", fontsize=8.0)
    axes[1].set_xlabel("x (µm)")
    axes[1].set_ylabel("y (µm)")
    _draw_lines(axes[2], pupil, merit)


def _draw_lines(panel: Axes, pupil: Any, merit: PupilMerit) -> None:
    width = getattr(merit, "line_width_um", 0.75 * pupil.wavelength_um / pupil.grid.half_width)
    contrast, picture = line_pair_picture(pupil, width, "worse", merit.refocus, POINTS)
    half = picture.half_width_um
    panel.imshow(picture.intensity, cmap="gray", origin="lower", extent=(-half, half, -half, half), vmin=0.0)
    along = f"{width:.3g} µm lines along {picture.orientation}"
    panel.set_title(f"{along}, contrast {contrast:.2f}", fontsize=8.0)
    panel.set_xlabel("x (µm)")
    panel.set_ylabel("y (µm)")

"""Pictures of a lens: layout, spot diagrams, arrival angles (Figs. 2b to 2d), and all of them as files.

Figures are built with matplotlib's object-oriented interface alone: no pyplot, no global settings.
"""

from __future__ import annotations

import math
import os
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from lensdesign.analysis.matching import spread_limit_sine
from lensdesign.analysis.spread import (
    ArrivalAngles,
    arrival_angles,
    observation_distance_mm,
    rms_spot_diameter,
)
from lensdesign.errors import InputError, atomic_path
from lensdesign.lens.lens import Lens
from lensdesign.pictures.charts import label_axes, spread_figure, white_figure
from lensdesign.pictures.figures import figure_map
from lensdesign.pictures.layout import layout_figure
from lensdesign.pictures.scene3d import RenderingError, render_lens
from lensdesign.tracing.bundles import launch, pupil_hexapolar
from lensdesign.tracing.paths import FIELD_COLORS
from lensdesign.tracing.rays import trace

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PICTURE_FORMATS = ("png", "svg")
DOTS_PER_INCH = 200
SENSOR_SHARES = (0.0, 3.0 / 11.2, 7.0 / 11.2, 9.0 / 11.2)
"""Points of Fig. 2d, as shares of half of the sensor's shorter side."""

_INK = "#333333"


def draw_all(
    lens: Lens,
    folder: str | os.PathLike[str],
    formats: Sequence[str] = ("png",),
    report: Callable[[str], None] = warnings.warn,
) -> list[Path]:
    """Write every picture of a lens: layout, spots, incidence, spread, measured figures, and a 3D view.

    Parameters
    ----------
    lens
        Any lens.
    folder
        Where the files go; made if needed.
    formats
        "png", "svg" or both; the 3D view is always PNG.
    report
        Told in one sentence if the 3D view was left out, and why: no rendering here, or no closed solid.

    Returns
    -------
    list of Path
        The files written.

    Raises
    ------
    InputError
        If a format is unknown, a file cannot be written, or the lens lets no light pass.
    """
    unknown = [f for f in formats if f not in PICTURE_FORMATS]
    if unknown or not formats:
        raise InputError(f"formats = {list(formats)}: allowed are {', '.join(PICTURE_FORMATS)}")
    figures = {
        "layout": layout_figure(lens),
        "spots": spot_figure(lens),
        "incidence": incidence_figure(lens),
        "spread": spread_figure(lens),
    }
    for i, surface in enumerate(lens.surfaces):
        if surface.figure is not None:
            figures[f"surface_{i + 1}_figure"] = figure_map(lens, i)
    paths = []
    for name, figure in figures.items():
        for form in formats:
            path = Path(folder) / f"{name}.{form}"
            write_figure(figure, path)
            paths.append(path)
    path = Path(folder) / "view3d.png"
    try:
        render_lens(lens, path)
    except (RenderingError, InputError) as error:
        report(f"3D view left out: {error}")
    else:
        paths.append(path)
    return paths


def write_figure(figure: Figure, path: str | os.PathLike[str]) -> None:
    """Write a figure as PNG or SVG, by suffix; the same figure gives the same file.

    Text in SVG stays text, so that a journal can set it in its own font.
    """
    from matplotlib import rc_context
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.backends.backend_svg import FigureCanvasSVG

    form = Path(path).suffix.lower().removeprefix(".")
    if form not in PICTURE_FORMATS:
        raise InputError(f"cannot write {path}: allowed suffixes are .{', .'.join(PICTURE_FORMATS)}")
    canvas = FigureCanvasAgg(figure) if form == "png" else FigureCanvasSVG(figure)
    metadata: dict[str, Any] = {} if form == "png" else {"Date": None}
    with atomic_path(path) as temporary, rc_context({"svg.hashsalt": "transferlens", "svg.fonttype": "none"}):
        canvas.print_figure(temporary, format=form, dpi=DOTS_PER_INCH, metadata=metadata)


def spot_figure(lens: Lens, plane_distance_mm: float | None = None) -> Figure:
    """Spot diagrams of field heights 0, 0.5 and 1 of the half field about their centroids (Fig. 2c).

    Parameters
    ----------
    lens
        Any lens.
    plane_distance_mm
        Plane of the spots, from the exit vertex; None is that of
        :func:`lensdesign.analysis.spread.observation_distance_mm`.

    Raises
    ------
    DesignError
        If no ray of a field passes.
    """
    plane_distance_mm = observation_distance_mm(lens) if plane_distance_mm is None else plane_distance_mm
    figure = white_figure((9.6, 3.9))
    panels = figure.subplots(1, 3, sharex=True, sharey=True)
    wavelength_um, pupil = lens.wavelengths_um[0], pupil_hexapolar(14).points
    reach = 0.0
    for axes, share, color in zip(panels, (0.0, 0.5, 1.0), FIELD_COLORS, strict=True):
        height = share * lens.half_field_mm
        spot = rms_spot_diameter(lens, wavelength_um, height, plane_distance_mm)
        origins, directions = launch(lens, [(0.0, height)], pupil, wavelength_um)
        plane_z_mm = lens.exit_vertex_z_mm + plane_distance_mm
        rays = trace(lens, origins, directions, wavelength_um, plane_z_mm=plane_z_mm)
        points = rays.position[rays.ok, :2] - spot.centroid_mm
        reach = max(reach, float(np.max(np.abs(points), initial=0.0)))
        axes.plot(*points.T, ".", color=color, ms=2.2, mew=0.0)
        passed = "" if spot.throughput > 1.0 - 1e-12 else f", {100.0 * spot.throughput:.1f} % pass"
        axes.set_title(
            f"field height {height:.3g} mm{passed}\nRMS diameter {_length(spot.rms_diameter_mm)}", fontsize=9
        )
        label_axes(axes, "x − centroid (mm)", "y − centroid (mm)")
        axes.label_outer()
    for axes in panels:
        axes.locator_params(nbins=5)
        axes.set_aspect("equal")
        axes.set(xlim=(-1.1 * reach, 1.1 * reach), ylim=(-1.1 * reach, 1.1 * reach))
    figure.suptitle(f"Spot diagrams {plane_distance_mm:g} mm behind the exit vertex", fontsize=10)
    return figure


def incidence_figure(
    lens: Lens,
    sensor_points_mm: Sequence[tuple[float, float]] | None = None,
) -> Figure:
    """Angles in which light of the whole object disc arrives at points of the sensor (Fig. 2d).

    Parameters
    ----------
    lens
        Any lens.
    sensor_points_mm
        x and y of the points, in the plane that :func:`spot_figure` takes; None takes four along y, in the
        paper's proportions to the sensor.
    """
    plane_distance_mm = observation_distance_mm(lens)
    if sensor_points_mm is None:
        half_mm = 0.5 * min(lens.sensor.size_mm)
        sensor_points_mm = [(0.0, float(f"{half_mm * share:.3g}")) for share in SENSOR_SHARES]
    wavelength_um = lens.wavelengths_um[0]
    limit_sine = spread_limit_sine(wavelength_um, lens.sensor.pixel_pitch_um)
    arrivals = [arrival_angles(lens, p, plane_distance_mm, wavelength_um) for p in sensor_points_mm]
    largest = max((a.largest_deg for a in arrivals if np.any(a.ok)), default=0.0)
    reach = 1.12 * max(math.degrees(math.asin(limit_sine)), largest)
    columns = min(4, len(arrivals))
    rows = math.ceil(len(arrivals) / columns)
    figure = white_figure((2.6 * columns + 0.6, 3.1 * rows + 0.9))
    panels = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False).ravel()
    for axes in panels[len(arrivals) :]:
        axes.remove()
    for axes, arrival in zip(panels, arrivals, strict=False):
        _draw_arrivals(axes, arrival, limit_sine)
        axes.set_aspect("equal")
        axes.set(xlim=(-reach, reach), ylim=(-reach, reach))
        label_axes(axes, r"$\theta_x$ (deg)", r"$\theta_y$ (deg)")
        axes.label_outer()
    handles: dict[str, Any] = {}
    for axes in panels[: len(arrivals)]:
        handles |= {label: h for h, label in zip(*axes.get_legend_handles_labels(), strict=True)}
    figure.legend(
        handles.values(),
        handles.keys(),
        loc="outside lower center",
        ncols=3,
        frameon=False,
        fontsize=9,
        markerscale=2,
    )
    figure.suptitle(
        f"Angles of incidence from the whole field, {plane_distance_mm:g} mm behind the exit vertex",
        fontsize=10,
    )
    return figure


def _draw_arrivals(axes: Axes, arrival: ArrivalAngles, limit_sine: float) -> None:
    angle = np.linspace(0.0, 2.0 * math.pi, 361)
    limit = limit_sine * np.stack([np.cos(angle), np.sin(angle)])
    limit_deg = np.rad2deg(np.arctan2(limit, math.sqrt(1.0 - limit_sine**2)))
    label = f"spread limit {math.degrees(math.asin(limit_sine)):.2f}°"
    axes.plot(*limit_deg, color=_INK, lw=1.0, label=label)
    points = arrival.angles_deg[arrival.ok]
    within = np.hypot(*arrival.cosines[arrival.ok].T) <= limit_sine
    axes.plot(*points[within].T, "o", color=FIELD_COLORS[2], ms=1.8, mew=0.0, label="within the limit")
    if not np.all(within):
        axes.plot(*points[~within].T, "D", color=FIELD_COLORS[0], ms=2.6, mew=0.0, label="beyond the limit")
    x, y = arrival.sensor_point_mm
    note = "no light arrives"
    if np.any(arrival.ok):
        note = f"up to {arrival.largest_deg:.2f}°, {100.0 * arrival.share:.0f} % of the field"
    axes.set_title(f"({x:g}, {y:g}) mm\n{note}", fontsize=9)


def _length(value_mm: float) -> str:
    return f"{value_mm:.2f} mm" if value_mm >= 0.1 else f"{1e3 * value_mm:.3g} µm"

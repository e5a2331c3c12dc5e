"""Pictures of a lens: layout, spot diagrams, arrival angles (Figs. 2b to 2d), and all of them as files.

Figures use only matplotlib's object-oriented interface: no pyplot, no global settings.
"""

from __future__ import annotations

import math
import os
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from lensdesign.analysis.arrival_angles import ArrivalAngles, arrival_angles
from lensdesign.analysis.exit_beam import rms_spot_diameter
from lensdesign.analysis.space_bandwidth import sensor_spread_sine
from lensdesign.common.arrays import Array
from lensdesign.common.atomic_files import atomic_path
from lensdesign.errors import InputError
from lensdesign.lens.lens import Lens
from lensdesign.plots.charts import label_axes, spread_figure, title_figure
from lensdesign.plots.layout import layout_figure
from lensdesign.plots.saving import save_figure
from lensdesign.plots.scene3d import RenderingError, render_lens
from lensdesign.plots.style import GREY, INK, RED, in_style, styled, styled_figure
from lensdesign.plots.surface_figures import surface_figure_map
from lensdesign.raytrace.bundles import launch, pupil_hexapolar
from lensdesign.raytrace.paths import FIELD_COLORS, FIELD_FRACTIONS
from lensdesign.raytrace.rays import trace

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PICTURE_FORMATS = ("png", "svg")
DOTS_PER_INCH = 200


def draw_all(
    lens: Lens,
    folder: str | os.PathLike[str],
    formats: Sequence[str] = ("png",),
    warn: Callable[[str], None] = warnings.warn,
) -> list[Path]:
    """Write all pictures of a lens: layout, spots, incidence, spread, measured figures, and a 3D view.

    Parameters
    ----------
    lens
        The lens.
    folder
        Folder of the files; created if necessary.
    formats
        "png", "svg" or both (default: "png"). The 3D view is always PNG.
    warn
        Called with one sentence if the 3D view is omitted, because rendering is not available or an element
        does not close (default: a Python warning).

    Returns
    -------
    list of Path
        The files written.

    Raises
    ------
    InputError
        If a format is unknown, a file cannot be written, or no light passes the lens.

    Examples
    --------
    >>> from lensdesign import draw_all, load_design
    >>> files = draw_all(load_design("designs/paper_singlet.toml"), "pictures")
    >>> [file.name for file in files[:4]]
    ['layout.png', 'spots.png', 'incidence.png', 'spread.png']
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
            figures[f"surface_{i + 1}_figure"] = surface_figure_map(lens, i)
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
        warn(f"3D view left out: {error}")
    else:
        paths.append(path)
    return paths


def write_figure(figure: Figure, path: str | os.PathLike[str]) -> None:
    """Write a figure as PNG or SVG, by suffix; the same figure yields identical files.

    Text in SVG stays text, so that a journal can set it in its own font.
    """
    form = Path(path).suffix.lower().removeprefix(".")
    if form not in PICTURE_FORMATS:
        raise InputError(f"cannot write {path}: allowed suffixes are .{', .'.join(PICTURE_FORMATS)}")
    with atomic_path(path) as temporary, styled({"svg.fonttype": "none"}):
        save_figure(figure, temporary, form, DOTS_PER_INCH, metadata={"Date": None})


@in_style
def spot_figure(lens: Lens, plane_distances_mm: Sequence[float] | None = None) -> Figure:
    """Plot spot diagrams of three field heights, with the outline of the sensor (Fig. 2c).

    Parameters
    ----------
    lens
        The lens.
    plane_distances_mm
        Distances of planes from the exit vertex in mm, one row for each (default: the first and the last
        sensor plane).

    Raises
    ------
    DesignError
        If no ray of a field passes.
    """
    planes = lens.sensor.plane_distances_mm
    if plane_distances_mm is None:
        plane_distances_mm = planes if len(planes) == 1 else (planes[0], planes[-1])
    rows, width, height = len(plane_distances_mm), *lens.sensor.size_mm
    figure = styled_figure(9.6, 0.8 + 0.7 * rows + 2.7 * rows * min(1.5, max(0.5, height / width)))
    panels = figure.subplots(rows, 3, sharex=True, sharey=True, squeeze=False)
    reach = np.array([0.5 * width, 0.5 * height])
    for row, distance_mm in zip(panels, plane_distances_mm, strict=True):
        for axes, fraction, color in zip(row, FIELD_FRACTIONS, FIELD_COLORS, strict=True):
            reach = np.maximum(reach, _draw_spot(axes, lens, fraction, color, distance_mm))
        row[0].set_ylabel(f"{distance_mm:g} mm behind the exit vertex\ny (mm)")
    for axes in panels.ravel():
        axes.set_aspect("equal")
        axes.set(xlim=1.06 * reach[0] * np.array([-1.0, 1.0]), ylim=1.06 * reach[1] * np.array([-1.0, 1.0]))
    light = f"{lens.wavelengths_um[0]:.4g} µm; frame: the sensor, {width:.4g} mm × {height:.4g} mm"
    title_figure(figure, lens, f"Spots on the sensor, {light}")
    return figure


def _draw_spot(axes: Axes, lens: Lens, fraction: float, color: str, distance_mm: float) -> Array:
    """Draw rays of a field height on a plane and the sensor's outline; return the largest |x| and |y|."""
    from matplotlib.patches import Rectangle

    wavelength_um, field_mm = lens.wavelengths_um[0], fraction * lens.half_field_mm
    spot = rms_spot_diameter(lens, wavelength_um, field_mm, distance_mm)
    origins, directions = launch(lens, [(0.0, field_mm)], pupil_hexapolar(14).points, wavelength_um)
    plane_z_mm = lens.exit_vertex_z_mm + distance_mm
    rays = trace(lens, origins, directions, wavelength_um, plane_z_mm=plane_z_mm)
    points = rays.position[rays.ok, :2]
    width, height = lens.sensor.size_mm
    axes.add_patch(Rectangle((-0.5 * width, -0.5 * height), width, height, fill=False, ec=INK, lw=1.2))
    axes.plot(*points.T, ".", color=color, ms=2.2, mew=0.0)
    passed = "" if spot.throughput > 1.0 - 1e-12 else f", {100.0 * spot.throughput:.1f} % pass"
    axes.set_title(
        f"field height {field_mm:.3g} mm{passed}\nRMS diameter {_length(spot.rms_diameter_mm)}", fontsize=9
    )
    label_axes(axes, "x (mm)", "y (mm)")
    axes.label_outer()
    return np.asarray(np.max(np.abs(points), axis=0, initial=0.0))


@in_style
def incidence_figure(
    lens: Lens,
    sensor_points_mm: Sequence[tuple[float, float]] | None = None,
) -> Figure:
    """Plot the angles of incidence of light from the whole object at points of the sensor (Fig. 2d).

    Parameters
    ----------
    lens
        The lens.
    sensor_points_mm
        x and y of points in the first sensor plane in mm (default: four points along y, in the paper's
        proportions to the sensor).
    """
    plane_distance_mm = lens.sensor.plane_distances_mm[0]
    if sensor_points_mm is None:
        half_mm = 0.5 * min(lens.sensor.size_mm)
        # Points of Fig. 2d, as fractions of half of the sensor's shorter side.
        sensor_fractions = (0.0, 3.0 / 11.2, 7.0 / 11.2, 9.0 / 11.2)
        sensor_points_mm = [(0.0, float(f"{half_mm * fraction:.3g}")) for fraction in sensor_fractions]
    wavelength_um = lens.wavelengths_um[0]
    limit_sine = sensor_spread_sine(lens, wavelength_um)
    arrivals = [arrival_angles(lens, p, plane_distance_mm, wavelength_um) for p in sensor_points_mm]
    largest = max((a.largest_deg for a in arrivals if np.any(a.ok)), default=0.0)
    reach = 1.12 * max(math.degrees(math.asin(limit_sine)), largest)
    columns = min(4, len(arrivals))
    rows = math.ceil(len(arrivals) / columns)
    figure = styled_figure(2.6 * columns + 0.6, 3.1 * rows + 0.9)
    panels = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False).ravel()
    for axes in panels[len(arrivals) :]:
        axes.remove()
    for axes, arrival in zip(panels, arrivals, strict=False):
        _draw_arrivals(axes, arrival, limit_sine)
        axes.set_aspect("equal")
        axes.set(xlim=(-reach, reach), ylim=(-reach, reach))
        label_axes(axes, r"$\theta_x$ (°)", r"$\theta_y$ (°)")
        axes.label_outer()
    handles: dict[str, Any] = {}
    for axes in panels[: len(arrivals)]:
        handles |= {label: h for h, label in zip(*axes.get_legend_handles_labels(), strict=True)}
    figure.legend(
        handles.values(),
        handles.keys(),
        loc="outside lower center",
        ncols=3,
        markerscale=2,
    )
    light = f"{wavelength_um:.4g} µm, {plane_distance_mm:g} mm behind the exit vertex"
    title_figure(figure, lens, f"Angles of incidence at points of the sensor, from the whole field; {light}")
    return figure


def _draw_arrivals(axes: Axes, arrival: ArrivalAngles, limit_sine: float) -> None:
    angle = np.linspace(0.0, 2.0 * math.pi, 361)
    limit = limit_sine * np.stack([np.cos(angle), np.sin(angle)])
    limit_deg = np.rad2deg(np.arctan2(limit, math.sqrt(1.0 - limit_sine**2)))
    label = f"spread limit {math.degrees(math.asin(limit_sine)):.2f}°"
    axes.plot(*limit_deg, color=INK, lw=1.0, label=label)
    points = arrival.angles_deg[arrival.ok]
    within = np.hypot(*arrival.cosines[arrival.ok].T) <= limit_sine
    axes.plot(*points[within].T, "o", color=GREY, ms=1.8, mew=0.0, label="within the limit")
    if not np.all(within):
        axes.plot(*points[~within].T, "D", color=RED, ms=2.6, mew=0.0, label="beyond the limit")
    x, y = arrival.sensor_point_mm
    note = "no light arrives"
    if np.any(arrival.ok):
        note = f"up to {arrival.largest_deg:.2f}°, {100.0 * arrival.fraction:.0f} % of the field"
    axes.set_title(f"({x:g}, {y:g}) mm\n{note}")


def _length(value_mm: float) -> str:
    return f"{value_mm:.2f} mm" if value_mm >= 0.1 else f"{1e3 * value_mm:.3g} µm"

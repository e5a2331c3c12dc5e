"""Layout of a lens: meridional section with rays, object, stop, sensor planes and scale (Fig. 2b).

The scale in mm per inch is chosen first, so that labels can be placed before anything is drawn. Labels of
stop and sensor planes are in rows above the lens, those of glasses below it. They are moved apart until none
overlaps another, and a dotted line connects each with its object.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.common.text import round_number_below
from lensdesign.lens.lens import Lens
from lensdesign.lens.solid import Element, glass_elements
from lensdesign.plots.charts import TITLE_POINTS, lens_name, text_inches
from lensdesign.plots.style import GLASS, GREY, INK, PAPER, in_style
from lensdesign.raytrace.bundles import pupil_fan
from lensdesign.raytrace.paths import FIELD_COLORS, FIELD_FRACTIONS, ray_paths, sized_lens

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


THIN, THICK = 0.8, 2.0
"""Line widths in points of outlines and rays, and of planes, ground edges and scale bar."""

LABEL_POINTS = 8.0

_MARGINS_INCHES = {"left": 0.38, "right": 0.08, "bottom": 0.86, "top": 0.34}
"""Margins for axis labels, legend and title; on the left, tick labels need additional space."""
_ROW_INCHES = 0.17
_GAP_INCHES = 0.1


@dataclass(frozen=True)
class _Frame:
    """Visible region of the plane in mm, and the scale in mm per inch."""

    left: float
    right: float
    reach: float
    scale: float


@dataclass(frozen=True)
class _Label:
    """A text and the point (z, y) on the lens where its dotted line starts."""

    text: str
    z: float
    y: float
    is_math: bool = False


@in_style
def layout_figure(lens: Lens) -> Figure:
    """Plot the meridional section with rays of three fields, object, sensor planes, stop, scale (Fig. 2b).

    Surfaces without a semi-diameter are drawn with the size of their footprint. Failed rays end where they
    fail. An object too small to be visible is drawn 2 points high.

    Raises
    ------
    InputError
        If a surface's size is neither given nor can be determined from rays.
    """
    lens = sized_lens(lens)
    elements = glass_elements(lens)
    fans = [
        ray_paths(lens, (0.0, fraction * lens.half_field_mm), pupil_fan(11).points)
        for fraction in FIELD_FRACTIONS
    ]
    frame = _frame(lens, elements, fans)
    above, below = _rows(_labels_above(lens), frame), _rows(_labels_below(lens, elements), frame)
    # The additional row below is for the scale bar.
    figure, axes = _figure(frame, len(above) + 0.4, len(below) + 1.6)
    _draw_glass(axes, elements)
    _draw_rays(axes, lens, fans, frame)
    _draw_stop(axes, lens, frame)
    _draw_planes(axes, lens, frame)
    _draw_labels(axes, above, frame, 1.0)
    _draw_labels(axes, below, frame, -1.0)
    _draw_scale_bar(axes, frame)
    _draw_title(figure, lens)
    figure.legend(
        loc="lower center",
        bbox_to_anchor=(0.5, 0.04 / figure.get_figheight()),
        ncols=len(FIELD_FRACTIONS),
        frameon=False,
        fontsize=9,
    )
    return figure


def _figure(frame: _Frame, rows_above: float, rows_below: float) -> tuple[Figure, Axes]:
    """Return an empty figure of the frame's scale, with space for rows of labels, and its axes."""
    from matplotlib.figure import Figure

    bands = np.array([rows_below, rows_above]) * _ROW_INCHES + _GAP_INCHES
    inner = np.array([frame.right - frame.left, 2.0 * frame.reach]) / frame.scale + [0.0, bands.sum()]
    # Tick labels of the two axes would overlap in the corners.
    at_z = _ticks(frame.left + 0.2 * frame.scale, frame.right - 0.25 * frame.scale)
    at_y = _ticks(-frame.reach, frame.reach)
    m = _MARGINS_INCHES
    left = m["left"] + max(text_inches(text, LABEL_POINTS)[0] for text in at_y.values())
    outer = inner + np.array([left + m["right"], m["bottom"] + m["top"]])
    figure = Figure(figsize=tuple(outer), facecolor=PAPER)
    axes = figure.add_axes((left / outer[0], m["bottom"] / outer[1], *(inner / outer)))
    axes.set_aspect("equal")
    low, high = np.array([-frame.reach, frame.reach]) + frame.scale * bands * [-1.0, 1.0]
    axes.set(xlim=(frame.left, frame.right), ylim=(low, high))
    axes.set_xlabel("z (mm)")
    axes.set_ylabel("y (mm)")
    axes.set_xticks([*at_z], [*at_z.values()])
    axes.set_yticks([*at_y], [*at_y.values()])
    axes.tick_params(direction="in")
    return figure, axes


def _frame(lens: Lens, elements: Sequence[Element], fans: Sequence[Array]) -> _Frame:
    solid = max(
        0.5 * lens.sensor.size_mm[1],
        max(float(element.outline()[:, 0].max()) for element in elements),
        max(s.semi_diameter_mm or 0.0 for s in lens.surfaces),
        lens.half_field_mm,
    )
    # Rays far outside of all bodies are clipped.
    rays = max(float(np.max(np.abs(paths[..., 1]))) for paths in fans)
    reach = 1.04 * min(max(solid, rays), 1.4 * solid)
    first, last = _ends(lens, elements)
    # Labels of planes close to the last one extend to both sides of it.
    crowd = sum(z > last - 0.1 * (last - first) for z in lens.sensor_z_mm)
    margins = (
        text_inches(_object_name(lens).split("\n")[1], LABEL_POINTS)[0] + 0.3,
        0.5 * min(max(crowd, 1), 4),
    )
    # Largest width and height of the drawing without labels.
    width, height = 9.3, 7.0
    scale = max((last - first) / (width - sum(margins)), 2.0 * reach / height)
    left, right = first - scale * margins[0], last + scale * margins[1]
    min_inches = (6.4, 1.2)
    spare = 0.5 * max(0.0, scale * min_inches[0] - (right - left))
    return _Frame(left - spare, right + spare, max(reach, 0.5 * scale * min_inches[1]), scale)


def _ticks(low: float, high: float) -> dict[float, str]:
    """Return round numbers from `low` to `high` and their texts."""
    from matplotlib.ticker import MaxNLocator

    values = np.asarray(MaxNLocator(7, steps=[1, 2, 5, 10]).tick_values(low, high))
    return {v: f"{v:.6g}".replace("-", "−") for v in values.tolist() if low <= v <= high}


def _ends(lens: Lens, elements: Sequence[Element]) -> tuple[float, float]:
    outlines = np.concatenate([element.outline()[:, 1] for element in elements])
    return min(lens.object_z_mm, float(outlines.min())), max(lens.sensor_z_mm[-1], float(outlines.max()))


def _object_name(lens: Lens) -> str:
    return f"object\nØ {lens.object.field_diameter_mm:g} mm"


def _labels_above(lens: Lens) -> list[_Label]:
    """Return the labels of the stop and the sensor planes, ordered by z."""
    half = 0.5 * lens.sensor.size_mm[1]
    z, rim = _stop_rim(lens)
    found = [_Label("stop", z, rim)]
    for index, distance in enumerate(lens.sensor.plane_distances_mm, start=1):
        z = lens.exit_vertex_z_mm + distance
        found.append(_Label(f"$H_{{{index}}}$ = {distance:g} mm", z, half, is_math=True))
    return sorted(found, key=lambda label: label.z)


def _labels_below(lens: Lens, elements: Sequence[Element]) -> list[_Label]:
    """Return the labels of the glasses, ordered by z."""
    found = []
    max_name_length = 24
    for element in elements:
        name = " ".join(str(lens.surfaces[element.surfaces[0]].material).split())
        if len(name) > max_name_length:
            name = name[: max_name_length - 1] + "…"
        outline = element.outline()
        widest = float(outline[:, 0].max())
        edge = outline[outline[:, 0] >= widest * (1.0 - 1e-9), 1]
        found.append(_Label(name, float(0.5 * (edge.min() + edge.max())), -widest))
    return found


def _rows(labels: Sequence[_Label], frame: _Frame) -> list[list[tuple[_Label, float]]]:
    """Distribute labels to as few rows as possible; return them with the z of their middles."""
    widths = np.array(
        [text_inches(label.text, LABEL_POINTS, label.is_math)[0] + _GAP_INCHES for label in labels]
    )
    margins = (frame.right - frame.left) / frame.scale - _GAP_INCHES
    count = 1
    while max(widths[row::count].sum() for row in range(count)) > margins and count < len(labels):
        count += 1
    rows = []
    for row in range(count):
        own, half = labels[row::count], 0.5 * widths[row::count]
        desired = np.array([(label.z - frame.left) / frame.scale for label in own])
        middles = frame.left + frame.scale * _spread(
            desired, half, 0.5 * _GAP_INCHES, margins + 0.5 * _GAP_INCHES
        )
        rows.append(list(zip(own, middles.tolist(), strict=True)))
    return rows


def _spread(desired: Array, half: Array, low: float, high: float) -> Array:
    """Return middles of non-overlapping intervals of given half widths, close to the desired ones.

    Groups that touch are moved together to the mean of the desired positions, as in isotonic regression (pool
    adjacent violators). `desired` must increase.
    """
    offsets = np.concatenate([[0.0], np.cumsum(half[:-1] + half[1:])])
    groups: list[tuple[float, int]] = []
    for value in desired - offsets:
        group = (float(value), 1)
        while groups and groups[-1][0] > group[0]:
            mean, count = groups.pop()
            total = count + group[1]
            group = ((mean * count + group[0] * group[1]) / total, total)
        groups.append(group)
    starts = np.repeat([mean for mean, _ in groups], [count for _, count in groups])
    return np.clip(starts, low + half[0], high - half[-1] - offsets[-1]) + offsets


def _stop_rim(lens: Lens) -> tuple[float, float]:
    radius = lens.stop_semi_diameter_mm
    z = lens.vertex_z_mm[lens.stop_index] + float(lens.surfaces[lens.stop_index].sag_mm(radius))
    return float(z), radius


def _draw_glass(axes: Axes, elements: Sequence[Element]) -> None:
    for element in elements:
        outline = element.outline()
        axes.fill(*_mirrored(outline).T, facecolor=GLASS, edgecolor=INK, lw=THIN, zorder=2)
        edge = element.edge_profile
        for sign in (1.0, -1.0):
            axes.plot(edge[:, 1], sign * edge[:, 0], color=INK, lw=THICK, solid_capstyle="butt", zorder=5)


def _mirrored(outline: Array) -> Array:
    """Return a meridian (r, z) and its mirror image as one closed polygon (z, y)."""
    upper = outline[:, ::-1]
    return np.concatenate([upper, upper[::-1] * [1.0, -1.0]])


def _draw_rays(axes: Axes, lens: Lens, fans: Sequence[Array], frame: _Frame) -> None:
    from matplotlib.collections import LineCollection
    from matplotlib.patches import Rectangle

    window = Rectangle(
        (frame.left, -frame.reach), frame.right - frame.left, 2.0 * frame.reach, transform=axes.transData
    )
    for fraction, color, paths in zip(FIELD_FRACTIONS, FIELD_COLORS, fans, strict=True):
        label = f"field height {fraction * lens.half_field_mm:.3g} mm"
        lines = LineCollection(
            [p[:, [2, 1]] for p in paths], colors=color, linewidths=THIN, zorder=3, label=label
        )
        axes.add_collection(lines, autolim=False)
        lines.set_clip_path(window)


def _draw_stop(axes: Axes, lens: Lens, frame: _Frame) -> None:
    """Draw two wedges that point at the rim of the stop."""
    z, radius = _stop_rim(lens)
    half, length = 0.05 * frame.scale, 0.16 * frame.scale
    for sign in (1.0, -1.0):
        wedge = [
            (z, sign * radius),
            (z - half, sign * (radius + length)),
            (z + half, sign * (radius + length)),
        ]
        axes.fill(*zip(*wedge, strict=True), color="black", lw=0.0, zorder=6)


def _draw_planes(axes: Axes, lens: Lens, frame: _Frame) -> None:
    """Draw the object, the sensor planes with the cover glass at each of them, and the axis."""
    line: dict[str, Any] = {"color": INK, "lw": THICK, "solid_capstyle": "butt", "zorder": 4}
    half = max(lens.half_field_mm, frame.scale / 72.0)
    axes.plot([lens.object_z_mm] * 2, [-half, half], **line)
    half, glass = 0.5 * lens.sensor.size_mm[1], lens.sensor.cover_glass
    for z in lens.sensor_z_mm:
        axes.plot([z, z], [-half, half], **line)
        if glass is not None:
            front, rear = z - glass.depth_mm, z - glass.distance_mm
            faces = [front, front, rear, rear], [-half, half, half, -half]
            axes.fill(*faces, facecolor=GLASS, edgecolor=INK, lw=THIN, zorder=2)
    axes.plot([lens.object_z_mm, lens.sensor_z_mm[-1]], [0.0, 0.0], "-.", color=GREY, lw=THIN, zorder=0)
    axes.annotate(
        _object_name(lens),
        (lens.object_z_mm, 0.0),
        xytext=(-5, 0),
        textcoords="offset points",
        ha="right",
        va="center",
        fontsize=LABEL_POINTS,
    )


def _draw_labels(axes: Axes, rows: Sequence[Any], frame: _Frame, sign: float) -> None:
    """Draw rows of labels with their dotted lines, above the lens (sign 1) or below it (-1)."""
    near = sign * (frame.reach + frame.scale * _GAP_INCHES)
    for index, row in enumerate(rows):
        y = near + sign * frame.scale * _ROW_INCHES * (index + 0.5)
        for label, middle in row:
            ends = [label.y, sign * frame.reach, near, y]
            axes.plot([label.z, label.z, middle, middle], ends, ":", color=GREY, lw=THIN, zorder=1)
            axes.text(
                middle,
                y,
                label.text,
                ha="center",
                va="center",
                fontsize=LABEL_POINTS,
                parse_math=label.is_math,
                bbox={"facecolor": PAPER, "edgecolor": "none", "pad": 0.5},
                zorder=7,
            )


def _draw_title(figure: Figure, lens: Lens) -> None:
    """Draw the title of the lens, truncated to the width of the figure, and the wavelength."""
    light = f"; light of {lens.wavelengths_um[0]:.4g} µm"
    title = lens_name(lens, figure.get_figwidth() - text_inches(light, TITLE_POINTS)[0]) + light
    y = 1.0 - 0.5 * _MARGINS_INCHES["top"] / figure.get_figheight()
    figure.text(0.5, y, title, ha="center", va="center", fontsize=TITLE_POINTS, parse_math=False)


def _draw_scale_bar(axes: Axes, frame: _Frame) -> None:
    bar = round_number_below(1.4 * frame.scale)
    left, y = frame.left + 0.15 * frame.scale, axes.get_ylim()[0] + 0.1 * frame.scale
    axes.plot([left, left + bar], [y, y], color=INK, lw=THICK, solid_capstyle="butt")
    axes.annotate(
        f"{bar:g} mm",
        (left + 0.5 * bar, y),
        xytext=(0, 3),
        textcoords="offset points",
        ha="center",
        va="bottom",
        fontsize=LABEL_POINTS,
    )

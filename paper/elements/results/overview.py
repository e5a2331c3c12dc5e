"""Figs. 1a and 1c: the system to scale, and what goes through it from frames to the object."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from lensdesign import Lens
from lensdesign.raytrace.paths import FIELD_COLORS, FIELD_FRACTIONS
from paper.drawing import arrow, bare, dimension, draw_glass, draw_rays, label, plane_line
from paper.element import Element, Made, Number, Work
from paper.elements.results.retrieval import SECONDS, SETTINGS
from paper.style import GREEN, GREY, panel, styled_figure
from paper.twin import retrieved, twin
from wavesim import propagate

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

BEAM_MM, ROOM_MM = 9.0, 11.0
"""Length of the beam that is drawn in front of the object; what is shown above and below the axis."""


def figure_1(work: Work) -> Made:
    """The system, and the steps from the recorded amplitudes to the object."""
    lens, scale = work.lens, work.settings["twin"]
    case = twin(scale)
    work.progress("retrieval")
    found = retrieved(scale, "chart", "forward model", work.settings["iterations"])
    at_vertex = propagate(found.field, -case.lens.sensor.plane_distances_mm[0], check=False)
    numbers = (
        Number("object to the second plane", lens.sensor_z_mm[-1] - lens.object_z_mm, "mm"),
        Number("object to the exit vertex", lens.exit_vertex_z_mm - lens.object_z_mm, "mm"),
        Number("optical elements", 1, "", 1),
    )
    steps = {
        "recorded: $\\sqrt{I_1}$": _powers(case.planes[0].values),
        "recorded: $\\sqrt{I_2}$": _powers(case.planes[1].values),
        "retrieved: |u| at z = 0": _powers(at_vertex.values),
        "object": np.abs(case.object_of(found.field).values),
    }
    side_mm = 1e-3 * case.lens.sensor.pixel_pitch_um * found.field.grid.shape[1]
    object_um = 1e3 * case.light.grid.pitch_mm * case.light.grid.shape[1]
    picture = work.picture(
        _figure_1(lens, steps, side_mm, object_um),
        f"Above: the system to scale. Below: from two amplitudes to the object, lens times {scale:.3g}.",
    )
    difference = (
        "The architecture is the same, and the drawing is the traced lens itself. The chart below is "
        "retrieved by Appendix A from amplitudes without noise and the forward model's start. The "
        "eikonal engine propagates the field back."
    )
    return Made(numbers, ("python -m paper --only figure-1",), difference, (picture,))


def _powers(values: Any) -> Any:
    amplitude = np.abs(values)
    return np.log10(np.maximum(amplitude / amplitude.max(), 1e-4))


def _figure_1(lens: Lens, steps: dict[str, Any], side_mm: float, object_um: float) -> Figure:
    figure = styled_figure(10.0, 6.6)
    grid = figure.add_gridspec(2, len(steps), height_ratios=(1.35, 1.0))
    _system(figure.add_subplot(grid[0, :]), lens)
    for number, (name, values) in enumerate(steps.items()):
        axes = figure.add_subplot(grid[1, number])
        if name == "object":
            panel(figure, axes, values, object_um, "µm", "amplitude", vmin=0.0, vmax=1.5)
        else:
            panel(figure, axes, values, side_mm, "mm", "amplitude, powers of ten", "inferno")
        axes.set_title(name)
    return figure


def _system(axes: Axes, lens: Lens) -> None:
    """Beam, field stop with the object, lens, sensor in two places."""
    bare(axes)
    start, half = lens.object_z_mm, lens.half_field_mm
    axes.fill(
        [start - BEAM_MM, start, start, start - BEAM_MM], [-half, -half, half, half], color=GREEN, alpha=0.25
    )
    for y in (-0.7 * half, 0.0, 0.7 * half):
        arrow(axes, [(start - BEAM_MM, y), (start - 1.0, y)])
    draw_glass(axes, lens)
    fields = zip((share * half for share in FIELD_FRACTIONS), FIELD_COLORS, strict=True)
    draw_rays(axes, lens, list(fields), 9)
    plane_line(axes, start, half)
    for sign in (-1.0, 1.0):
        axes.plot([start, start], [sign * half, sign * 4.0 * half], color=GREY, lw=4.0, solid_capstyle="butt")
    side = 0.5 * min(lens.sensor.size_mm)
    for number, z in enumerate(lens.sensor_z_mm, start=1):
        plane_line(axes, z, side, lw=3.0, ls="-" if number == 1 else (0, (4, 1)))
        label(axes, (z, ROOM_MM + 1.6), f"sensor at $H_{number}$")
    wavelength = f"coherent light, {lens.wavelengths_um[0]:g} µm"
    label(axes, (start - 0.6 * BEAM_MM, -half - 1.2), wavelength)
    label(axes, (start, ROOM_MM - 3.2), f"object in a field stop of {2.0 * half:g} mm")
    label(axes, (4.5, ROOM_MM + 1.6), "transfer lens")
    dimension(axes, (start, -ROOM_MM - 1.0), (0.0, -ROOM_MM - 1.0), f"{-start:g} mm")
    near, far = lens.sensor_z_mm
    dimension(axes, (near, -ROOM_MM - 1.6), (far, -ROOM_MM - 1.6), f"{far - near:g} mm")
    axes.set(xlim=(start - BEAM_MM - 1.0, far + 3.0), ylim=(-ROOM_MM - 3.0, ROOM_MM + 3.0), aspect="equal")


FIGURE_1 = Element(
    "figure-1",
    "Figs. 1a and 1c: the system",
    "A coherent beam illuminates the object. One lens of two smooth surfaces carries its light to a "
    "sensor, which records two intensity patterns. A backward model of the wave propagation gives the "
    "object.",
    figure_1,
    SETTINGS,
    SECONDS,
)

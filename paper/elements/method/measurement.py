"""Figs. 3 and 9: two intensities, and how the field between lens and sensor is retrieved from them."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from lensdesign import Lens
from lensdesign.analysis import footprint
from lensdesign.raytrace.paths import FIELD_COLORS, FIELD_FRACTIONS
from paper.drawing import arrow, bare, box, dimension, draw_glass, draw_rays, label, plane_line
from paper.element import Element, Made, Number, Work
from paper.elements.results.retrieval import PAPER_ITERATIONS, SECONDS, SETTINGS
from paper.style import GREEN, ORANGE, panel, styled_figure
from paper.twin import retrieved, twin
from wavesim import ImageSettings, ReconstructionSettings, propagate
from wavesim.reconstruction.phase_retrieval import FEEDBACK, TV_STEP
from wavesim.sensor import diversity
from wavesim.targets import object_patch

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PAPER_FEEDBACK, PAPER_TV_STEP = (0.7, 0.5), 0.05


def figure_3(work: Work) -> Made:
    """Where the planes stand, what they tell, and the flow of the retrieval with its constants."""
    lens = work.lens
    near, far = lens.sensor.plane_distances_mm
    feet = [footprint(lens, plane_distance_mm=plane) for plane in (near, far)]
    predicted = diversity(lens, object_patch(lens, lens.object.field_diameter_mm), (near, far))
    numbers = (
        Number("distance between the two planes", far - near, "mm", 20.0),
        Number("first plane, behind the exit vertex", near, "mm"),
        Number("radius of the light on it", feet[0].radius_mm, "mm"),
        Number("radius of the light on the second plane", feet[1].radius_mm, "mm"),
        Number("half of the sensor's shorter side", feet[1].sensor_half_side_mm, "mm"),
        Number("phase diversity of the planes, Δz w² / (λ f²)", predicted),
        Number("bits of a count", ImageSettings().bits, "", 12),
        Number("iterations", ReconstructionSettings(method="paper").most_iterations, "", PAPER_ITERATIONS),
        Number("step t of A4", TV_STEP, "", PAPER_TV_STEP),
        Number("weight a of A5", FEEDBACK[0], "", PAPER_FEEDBACK[0]),
        Number("weight b of A5", FEEDBACK[1], "", PAPER_FEEDBACK[1]),
    )
    picture = work.picture(
        _figure_3(lens), "Left: both planes, to scale, with rays of three field heights. Right: an iteration."
    )
    difference = (
        "Steps and constants are the same. The paper states the distance between the planes but not "
        "their positions. At 2 and 22 mm the light just fits the sensor. The paper does not state the "
        "scale of the amplitudes, on which its step t depends. Here their median in the lit area is 64."
    )
    command = "python -m pytest tests/wavesim/reconstruction/test_phase_retrieval.py"
    return Made(numbers, (command,), difference, (picture,))


def _figure_3(lens: Lens) -> Figure:
    figure = styled_figure(10.2, 4.6)
    left, right = figure.subplots(1, 2, width_ratios=(1.15, 1.0))
    _measured(left, lens)
    _iteration(right)
    return figure


def _measured(axes: Axes, lens: Lens) -> None:
    near, far = lens.sensor_z_mm
    vertex, half = lens.exit_vertex_z_mm, 0.5 * min(lens.sensor.size_mm)
    draw_glass(axes, lens)
    fields = zip((share * lens.half_field_mm for share in FIELD_FRACTIONS), FIELD_COLORS, strict=True)
    draw_rays(axes, lens, list(fields), 7)
    plane_line(axes, vertex, half, ls="--", lw=1.0)
    for z, name in ((vertex, "z = 0"), (near, "$H_1$"), (far, "$H_2$")):
        label(axes, (z + (0.7 if z == near else -0.7 if z == vertex else 0.0), half + 1.3), name)
    for z in (near, far):
        plane_line(axes, z, half)
    dimension(axes, (near, -half - 1.3), (far, -half - 1.3), f"{far - near:g} mm")
    dimension(axes, (lens.object_z_mm, -half - 1.3), (0.0, -half - 1.3), f"{-lens.object_z_mm:g} mm")
    plane_line(axes, lens.object_z_mm, lens.half_field_mm)
    bare(axes)
    axes.set(aspect="equal", title="two intensities", xlim=(lens.object_z_mm - 1.5, far + 1.5))
    axes.set_ylim(-half - 3.0, half + 3.0)


def _iteration(axes: Axes) -> None:
    bare(axes)
    axes.set(xlim=(-0.2, 8.2), ylim=(-0.3, 8.1), title="dual-plane retrieval")
    left, right, wide, tall = 1.9, 6.1, 3.5, 0.95
    box(
        axes,
        (4.0, 7.4),
        (6.2, tall),
        "field u at z = 0; at first: forward model, even or random",
        ORANGE,
    )
    for x, number in ((left, 1), (right, 2)):
        box(axes, (x, 5.9), (wide, tall), f"A1: to z = $H_{number}$\nby the angular spectrum")
        box(axes, (x, 4.5), (wide, tall), f"A2: amplitude becomes $\\sqrt{{I_{number}}}$,\nthe phase stays")
        box(axes, (x, 3.1), (wide, tall), f"A3: back to z = 0;\nA4: total variation, t = {TV_STEP:g}")
        arrow(axes, [(x, 6.92), (x, 6.38)])
        arrow(axes, [(x, 5.42), (x, 4.98)])
        arrow(axes, [(x, 4.02), (x, 3.58)])
        arrow(axes, [(x, 2.62), (x, 2.18)])
    mean = f"mean of both; A5: feedback, a = {FEEDBACK[0]:g}, b = {FEEDBACK[1]:g}"
    box(axes, (4.0, 1.7), (6.2, tall), mean)
    arrow(axes, [(7.1, 1.7), (8.05, 1.7), (8.05, 7.4), (7.1, 7.4)])
    box(
        axes,
        (4.0, 0.3),
        (6.2, tall),
        f"after {PAPER_ITERATIONS} times: u; A6 at $H_1$ computed each time",
        GREEN,
    )
    arrow(axes, [(4.0, 1.22), (4.0, 0.78)])


def figure_9(work: Work) -> Made:
    """The field sought and both amplitudes, of a chart in front of a twin."""
    scale, iterations = work.settings["twin"], work.settings["iterations"]
    case = twin(scale)
    work.progress(f"{iterations} iterations")
    found = retrieved(scale, "chart", "forward model", iterations)
    near, far = case.lens.sensor.plane_distances_mm
    at_vertex = propagate(found.field, -near, check=False)
    numbers = (
        Number("relative residual on the first plane", found.residuals[0]),
        Number("relative residual on the second plane", found.residuals[1]),
    )
    shown = {
        "sought: |u| at z = 0": at_vertex.values / case.scale,
        f"recorded: $\\sqrt{{I_1}}$ at {near:g} mm": case.planes[0].values,
        f"recorded: $\\sqrt{{I_2}}$ at {far:g} mm": case.planes[1].values,
    }
    figure = styled_figure(9.8, 3.5)
    side_mm = 1e-3 * case.lens.sensor.pixel_pitch_um * at_vertex.grid.shape[1]
    for axes, (name, values) in zip(figure.subplots(1, 3), shown.items(), strict=True):
        powers = np.log10(np.maximum(np.abs(values) / np.abs(values).max(), 1e-4))
        panel(figure, axes, powers, side_mm, "mm", "amplitude, powers of ten", "inferno")
        axes.set_title(name)
    caption = (
        f"A chart in front of a lens {1.0 / scale:.0f} times as small: "
        "the recorded and the retrieved amplitudes."
    )
    difference = (
        "The figure of the paper is a drawing. This one shows the amplitudes themselves, on a twin with the "
        f"same angles. The distances of both planes are those of the lens divided by {1.0 / scale:.0f}."
    )
    assert math.isclose(near / far, 2.0 / 22.0)
    return Made(numbers, ("python -m paper --only figure-9",), difference, (work.picture(figure, caption),))


FIGURE_3 = Element(
    "figure-3",
    "Fig. 3: two intensities and the retrieval's flow",
    "Two intensity patterns of 12 bits are recorded 20 mm apart. The field at the exit vertex is "
    "retrieved from them in 500 iterations, with weights 0.7 and 0.5 and a total-variation step of 0.05.",
    figure_3,
)
FIGURE_9 = Element(
    "figure-9",
    "Fig. 9 and Eqs. A1 to A6: planes of the retrieval",
    "The field at z = 0 is propagated to two planes, gets the recorded amplitudes on them, and is "
    "propagated back.",
    figure_9,
    SETTINGS,
    SECONDS,
)

"""Fig. 11 and Eqs. C1 to C7: the whole way back through the lens, from plane to plane."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from paper.drawing import arrow, bare, draw_glass, label, plane_line
from paper.element import Element, Made, Number, Work
from paper.elements.method.slicing import Sliced
from paper.style import BLUE, GLASS, GREEN, GREY, INK, ORANGE, VIOLET, styled_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SLICES, FOLLOWED = 6, 2
"""Of each surface, so that they can be seen; which of them is followed, from the object on."""


def figure_11(work: Work) -> Made:
    """The planes of the way back, with the steps between them."""
    lens = work.lens
    entrance, exit_ = Sliced(lens, 200).planes_mm
    vertex = lens.exit_vertex_z_mm
    numbers = (
        Number("last cutting plane of the exit surface", float(exit_[0]) - vertex, "mm"),
        Number("virtual plane z_temp: where the exit slices are summed", float(exit_[0]) - vertex, "mm"),
        Number("first cutting plane of the entrance surface", float(entrance[-1]) - vertex, "mm"),
        Number("tangential plane z_en of the entrance vertex", -vertex, "mm"),
        Number("object", lens.object_z_mm - vertex, "mm"),
        Number("steps from plane to plane, 200 slices a surface", 2 * (len(entrance) + len(exit_) - 2) + 2),
    )
    picture = work.picture(
        _figure_11(Sliced(lens, SLICES)),
        f"The path back through the lens, drawn to scale with {SLICES} slices per surface; one slice of each "
        "is followed.",
    )
    difference = (
        "The path is the same, with z measured from the exit vertex. The virtual plane is the cutting "
        "plane through the edge of the exit surface, in glass, so no further step is needed. The "
        "engine's adjoint is exact to rounding (dot-product test) and uses the same planes as the "
        "forward direction. Its working grid is fine enough for light of NA 0.5 in glass everywhere. It "
        "replaces Bluestein's method of Appendix B, which free-space propagation uses "
        "(`wavesim.fields.propagator`) if pitches differ."
    )
    command = (
        "wavesim resolve-lines designs/paper_singlet.toml --engine slices --slices 200 "
        "--compensation vertical --linewidths-um 1.55,0.775,0.532"
    )
    return Made(numbers, (command, "python -m pytest tests/wavesim/engines/slices"), difference, (picture,))


def _figure_11(cut: Sliced) -> Figure:
    figure = styled_figure(10.4, 5.6)
    grid = figure.add_gridspec(2, 2, width_ratios=(1.5, 1.0))
    _whole(figure.add_subplot(grid[:, 0]), cut)
    vertex, virtual = cut.lens.exit_vertex_z_mm, float(cut.planes_mm[1][0])
    _zoomed(
        figure.add_subplot(grid[0, 1]),
        cut,
        1,
        ((vertex, "z = 0"), (virtual, "$z_{temp}$")),
        ("C1, C2", "C3", "C4"),
        ("$p_1$", "$p_2$"),
    )
    ends = ((2.4 * float(cut.planes_mm[0][-1]), "from $z_{temp}$"), (0.0, "$z_{en}$"))
    _zoomed(figure.add_subplot(grid[1, 1]), cut, 0, ends, ("C5", "C6", "C7"), ("$q_1$", "$q_2$"))
    return figure


def _whole(axes: Axes, cut: Sliced) -> None:
    """The lens with all planes, to scale."""
    lens = cut.lens
    vertex, virtual = lens.exit_vertex_z_mm, float(cut.planes_mm[1][0])
    bare(axes)
    draw_glass(axes, lens)
    for surface, planes in enumerate(cut.planes_mm):
        for z in planes:
            plane_line(axes, float(z), 10.8, color=GREY, lw=0.6)
        low, high = (float(z) for z in planes[FOLLOWED : FOLLOWED + 2])
        radii = sorted(float(cut.radius_mm(surface, z)) for z in (low, high))
        for z in (low, high):
            for sign in (1.0, -1.0):
                axes.plot(
                    [z, z], [sign * radii[0], sign * radii[1]], color=GREEN, lw=3.0, solid_capstyle="butt"
                )
    for z, style in ((vertex, {}), (0.0, {}), (virtual, {"color": VIOLET, "ls": "--"})):
        plane_line(axes, z, 11.8, **({"color": BLUE, "lw": 1.6} | style))
    plane_line(axes, lens.object_z_mm, lens.half_field_mm)
    for z, height, text in (
        (vertex + 0.4, 12.7, "z = 0"),
        (virtual, -12.7, f"virtual plane: {virtual - vertex:.3g} mm"),
        (-0.9, 12.7, f"$z_{{en}}$ = {-vertex:g} mm"),
        (lens.object_z_mm, 2.6, f"object: {lens.object_z_mm - vertex:g} mm"),
    ):
        label(axes, (z, height), text)
    arrow(axes, [(-0.4, 0.0), (lens.object_z_mm + 0.3, 0.0)], "refocusing")
    arrow(axes, [(vertex + 4.6, 0.0), (vertex + 0.3, 0.0)], "u")
    axes.set(xlim=(lens.object_z_mm - 3.0, vertex + 5.0), ylim=(-13.8, 13.8), aspect="equal")


def _zoomed(
    axes: Axes,
    cut: Sliced,
    surface: int,
    ends: tuple[tuple[float, str], tuple[float, str]],
    steps: tuple[str, str, str],
    annuli: tuple[str, str],
) -> None:
    """One slice with the steps through it; along the axis and across in scales of their own."""
    planes = cut.planes_mm[surface]
    low, high = (float(z) for z in planes[FOLLOWED : FOLLOWED + 2])
    inner, outer = sorted(float(cut.radius_mm(surface, z)) for z in (low, high))
    rise, middle = outer - inner, 0.5 * (inner + outer)
    z = np.linspace(float(planes[0]), float(planes[-1]), 200)
    r = cut.radius_mm(surface, z)
    (start, start_name), (end, end_name) = ends
    glass = float(planes[0]) if surface else start
    axes.fill_betweenx(r, z, glass, color=GLASS, lw=0.0)
    axes.plot(z, r, color=INK, lw=1.4)
    for plane in planes:
        axes.axvline(float(plane), color=GREY, lw=0.6)
    for at, name in ((high, annuli[0]), (low, annuli[1])):
        axes.plot([at, at], [inner, outer], color=GREEN, lw=4.0, solid_capstyle="butt")
        label(axes, (at, outer + 0.25 * rise), name)
    style = {"arrowstyle": "-|>", "color": ORANGE, "lw": 1.4}
    for (first, last), step in zip(((start, high), (high, low), (low, end)), steps, strict=True):
        axes.annotate("", (last, middle), (first, middle), arrowprops=style)
        place = 0.5 * (first + last), middle - 0.2 * rise
        axes.text(*place, step, ha="center", va="top", color=ORANGE, fontsize=8)
    for at, name in ((start, start_name), (end, end_name)):
        axes.axvline(at, color=VIOLET if "temp" in name else BLUE, lw=1.6, ls="--" if "temp" in name else "-")
        label(axes, (at, inner - 1.1 * rise), name)
    axes.set(
        xlabel="z from the entrance vertex (mm)",
        ylabel="radial height (mm)",
        ylim=(inner - 1.4 * rise, outer + 0.6 * rise),
    )
    axes.grid(visible=False)


ELEMENTS = (
    Element(
        "figure-11",
        "Fig. 11 and Eqs. C1 to C7: the full path",
        "The field passes from the tangential plane at the exit vertex to each annulus p₁ in air (C1, "
        "C2), over the slice to p₂ in glass (C3), and to one virtual plane, where all are summed (C4). "
        "It continues to each q₁ (C5), over the slice to q₂ in air (C6), and to the tangential plane at "
        "the entrance vertex (C7).",
        figure_11,
        seconds={"quick": 2.0, "full": 2.0},
    ),
)

"""Fig. 2a: how such a lens is designed, with the numbers of this one, and the search done again."""

from __future__ import annotations

from typing import TYPE_CHECKING

from lensdesign import CheckReport, load_specification, optimize
from lensdesign.analysis import check_design
from lensdesign.optimization import OptimizationResult
from paper.drawing import arrow, bare, box, label
from paper.element import DESIGNS, PAPER_DESIGN, Element, Made, Number, Work
from paper.style import GREEN, ORANGE, styled_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SPECIFICATION = "feasible_singlet_spec.toml"


def figure_2a(work: Work) -> Made:
    """The flow, and what a search for the smallest spread finds at the paper's thickness."""
    found, printed = optimize(load_specification(DESIGNS / SPECIFICATION)), check_design(work.lens)
    front, back = found.lens.surfaces
    numbers = (
        Number("largest angle of the lens of Table 1", printed.max_spread_deg, "°", digits=5),
        Number(
            "smallest that is found at its thickness, aperture and distance", found.goal_value, "°", digits=5
        ),
        Number("its entrance surface: radius", front.radius_mm or 0.0, "mm"),
        Number("its exit surface: radius", back.radius_mm or 0.0, "mm"),
        Number("its exit surface: conic constant", back.conic),
    )
    picture = work.picture(
        _flow(printed, found), "The process of the design; each box contains the numbers of this lens."
    )
    difference = (
        "The process is the paper's. A new search from a plane-parallel plate uses the same thickness, "
        "aperture, distances and kinds of surfaces. It finds a smaller angle than Table 1 and meets Eq. "
        "2, which Table 1 misses by 0.9 %."
    )
    command = f"lensdesign optimize designs/{SPECIFICATION} -o found.toml"
    return Made(numbers, (command,), difference, (picture,))


def _flow(printed: CheckReport, found: OptimizationResult) -> Figure:
    lens, front, back = found.lens, *found.lens.surfaces
    target, sensor = lens.object, lens.sensor
    figure = styled_figure(9.6, 4.6)
    axes = figure.subplots()
    bare(axes)
    axes.set(xlim=(-0.3, 11.8), ylim=(0.0, 5.5))
    first, second, third, fourth = 1.2, 4.15, 7.1, 10.3
    upper, lower, last = 4.3, 2.55, 0.65
    size, asked = (2.4, 1.1), (2.7, 1.3)
    wanted = f"asked: field {target.field_diameter_mm:g} mm,\nNA {target.numerical_aperture:g}"
    box(axes, (first, upper), size, wanted)
    box(axes, (second, upper), size, f"SBP of the object (Eq. 1):\n{1e-6 * printed.sbp_object:.2f} million")
    pixels = f"sensor: Δ = {sensor.pixel_pitch_um:g} µm,\nD = {min(sensor.size_mm):g} mm,\n"
    pixels += f"SBP {1e-6 * printed.sbp_sensor:.2f} million"
    box(axes, (third, upper), size, pixels)
    box(axes, (fourth, upper), asked, "SBP of sensor ≥\nSBP of object?", ORANGE, question=True)
    limit = f"θ ≤ {printed.spread_limit_deg:.5g}° (Eq. 2):\n{printed.highest_frequency_lp_per_mm:g} lp/mm"
    box(axes, (fourth, lower), size, limit)
    varied = f"sphere, conic; {front.material},\n{front.thickness_mm:g} mm thick:\nradii and conic are varied"
    box(axes, (third, lower), size, varied)
    box(axes, (second, lower), size, "rays of sampled field\npoints are traced:\nlargest angle θ")
    box(axes, (first, lower), asked, "θ ≤ limit, and\nno smaller one?", ORANGE, question=True)
    done = (
        f"found from a plate: {front.radius_mm:.4g} mm; {back.radius_mm:.4g} mm, conic {back.conic:.4g}:   "
        f"θ = {found.goal_value:.4f}°\n"
        f"Table 1: 42.3 mm; −12 mm, conic −0.8986:   θ = {printed.max_spread_deg:.4f}°"
    )
    box(axes, (0.5 * (second + third), last), (7.0, 0.85), done, GREEN)
    half, tip = 0.5 * size[0], 0.5 * asked[0]
    for left, right, end in ((first, second, half), (second, third, half), (third, fourth, tip)):
        arrow(axes, [(left + half, upper), (right - end, upper)])
    for right, left, end in ((fourth, third, half), (third, second, half), (second, first, tip)):
        arrow(axes, [(right - half, lower), (left + end, lower)])
    arrow(axes, [(fourth, upper - 0.65), (fourth, lower + 0.55)], "yes")
    over = [(fourth, upper + 0.65), (fourth, 5.25), (third, 5.25), (third, upper + 0.55)]
    arrow(axes, over)
    arrow(axes, [(first, lower + 0.65), (first, 3.45), (third, 3.45), (third, lower + 0.55)])
    arrow(axes, [(first, lower - 0.65), (first, last), (0.5 * (second + third) - 3.5, last)])
    for place, text in (
        ((8.7, 5.25), "no: other pixels"),
        ((4.15, 3.45), "no: other surfaces"),
        ((first, 1.5), "yes"),
    ):
        label(axes, place, text)
    return figure


ELEMENTS = (
    Element(
        "figure-2a",
        "Fig. 2a: the process of the design",
        "Field and NA give the SBP of the lens, which determines the sensor (Eq. 1). Its pixels "
        "determine the largest angle (Eq. 2). Then the surfaces are optimized until no ray of the "
        "sampled field points exceeds it.",
        figure_2a,
        seconds={"quick": 4.0, "full": 4.0},
        designs=(PAPER_DESIGN, SPECIFICATION),
    ),
)

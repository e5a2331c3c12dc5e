"""Fig. 6: tissue over the whole field, and what two objectives show of the same."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from lensdesign.common.arrays import Array
from paper.element import Budget, Element, Made, Number, Work
from paper.microscope import Objective
from paper.shots import BRACKET, Shot, shot
from paper.style import RED, faint_panel, panel, styled_figure
from wavesim import Field, Grid, ReconstructionSettings, propagate, reconstruct_frames
from wavesim.targets.region import cut_field

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LOW, HIGH = Objective("2×, NA 0.08", 0.08), Objective("20×, NA 0.5", 0.5)
COHERENCE = 0.7
"""Aperture of the microscope's condenser over the objective's; the paper names none."""

HIGH_FIELD_MM = 1.25
CROP_SHARE = 0.22
"""Side of a crop over the field's diameter."""

JUDGED = 0.8
"""Of the field stop's diameter, in which intensities are compared."""

CROPS = ((0.0, 0.0), (-0.2, 0.16), (0.2, 0.18), (0.05, -0.27))
"""Middles of the crops d to g, in diameters of the field."""

SETTINGS: dict[Budget, dict[str, float]] = {
    "small": {"twin": 1 / 48, "iterations": 12, "planes": 4},
    "quick": {"twin": 1 / 16, "iterations": 40, "planes": 4},
    "full": {"twin": 1 / 8, "iterations": 80, "planes": 4},
}


class _Seen(NamedTuple):
    """All that is drawn."""

    one: Shot
    vertex: Field
    found: Field
    views: dict[str, Array]
    light: Grid


def figure_6(work: Work) -> Made:
    """The whole field from frames, crops, and the objectives' views."""
    scale, planes = work.settings["twin"], int(work.settings["planes"])
    work.progress("frames")
    one = shot(scale, "tissue", BRACKET, planes)
    work.progress("in the object domain")
    chosen = one.imaged.settings
    settings = ReconstructionSettings(
        kind="complex",
        engine="eikonal",
        error=0.1,
        patch_mm=chosen.patch_mm,
        field_stop_mm=chosen.field_stop_mm,
        object_pitch_um=chosen.object_pitch_um,
        iterations=int(work.settings["iterations"]),
    )
    result = reconstruct_frames(one.lens, one.imaged.frames, settings)
    found = one.light.with_values(one.light.values * result.transmission.values)
    vertex = propagate(one.case.engine.forward(found), -one.lens.sensor.plane_distances_mm[0], check=False)
    work.progress("objectives")
    true = one.light.with_values(one.light.values * one.imaged.target.transmission.values)
    views = {
        "low": LOW.partially_coherent(true, COHERENCE),
        "high": HIGH.partially_coherent(true, COHERENCE),
        "low, coherent": LOW.coherent(true),
        "high, coherent": HIGH.coherent(true),
    }
    seen = _Seen(one, vertex, found, views, one.light.grid)
    pictures = (
        work.picture(
            _whole(seen),
            "a: light on the first plane. b: exit vertex plane. c: the whole field; the crops in red.",
        ),
        work.picture(
            _crops(seen),
            "Above, one crop: from the frames (d1), with the 2× (d2) and the 20× objective (d3), and "
            "with the 20× in coherent light. Below: three more crops, and the phase of the first, which "
            "no objective shows.",
            "crops",
        ),
    )
    numbers = _numbers(seen, work.lens.object.field_diameter_mm, result.verdict.over_noise)
    return Made(numbers, ("python -m paper --only figure-6",), DIFFERENCE, pictures)


DIFFERENCE = (
    "No data of the tissue are published. Ours is a complex phantom of nuclei, fibres and a nonuniform "
    "background over the whole field of the twin. It is reconstructed from brackets on four planes, "
    "because two determine a complex object poorly. Objectives are without aberrations and partially "
    "coherent, with a condenser of 0.7 times their aperture (about thirty directions within its circle). "
    "The result of the lens is comparable with the 20× objective, as the paper says, over a field 2.4 "
    "times as wide. It also contains the phase."
)


def _numbers(seen: _Seen, field_mm: float, over_noise: float) -> tuple[Number, ...]:
    one = seen.one
    inside = _well_inside(one)
    own = np.abs(seen.found.values) ** 2
    coherent, low, high = (seen.views[name] for name in ("high, coherent", "low", "high"))
    return (
        Number("diameter of the field", field_mm, "mm", 3.0),
        Number("that over the 20× objective's 1.25 mm", field_mm / HIGH_FIELD_MM, "", 2.4),
        Number("correlation with the tissue, complex", one.correlation(seen.found)),
        Number("misfit over that of the noise", over_noise),
        Number(
            "intensity: correlation with the 20× objective's in coherent light", _alike(own, coherent, inside)
        ),
        Number("with the 20× objective's, condenser 0.7 NA", _alike(own, high, inside)),
        Number("with the 2× objective's, condenser 0.7 NA", _alike(own, low, inside)),
        Number("contrast of the tissue (standard deviation over mean), as found", _contrast(own, inside)),
        Number("the same, by the 20× objective", _contrast(high, inside)),
        Number("the same, by the 2× objective", _contrast(low, inside)),
    )


def _well_inside(one: Shot) -> Array:
    """Samples so far from the field stop's edge that no objective blurs it over them."""
    grid, radius = one.light.grid, 0.5 * JUDGED * one.imaged.patch.field_stop_mm
    return np.asarray(np.hypot(grid.x_mm, grid.y_mm[:, None]) <= radius)


def _alike(a: Array, b: Array, inside: Array) -> float:
    return float(np.corrcoef(a[inside], b[inside])[0, 1])


def _contrast(intensity: Array, inside: Array) -> float:
    return float(np.std(intensity[inside]) / np.mean(intensity[inside]))


def _whole(seen: _Seen) -> Figure:
    one = seen.one
    figure = styled_figure(10.0, 3.2)
    first, second, third = figure.subplots(1, 3)
    pitch_mm = 1e-3 * one.lens.sensor.pixel_pitch_um
    recorded = np.square(one.case.recorded[0].amplitude)
    at_plane = f"plane at {one.lens.sensor.plane_distances_mm[0]:.3g} mm"
    for axes, values, name, quantity in (
        (first, recorded, at_plane, "intensity"),
        (second, np.abs(seen.vertex.values), "exit vertex plane", "amplitude"),
    ):
        faint_panel(figure, axes, values, pitch_mm * values.shape[1], quantity, 20.0)
        axes.set_title(name)
    width_um = 1e3 * seen.light.pitch_mm * seen.light.shape[1]
    panel(figure, third, np.abs(seen.found.values) ** 2, width_um, "µm", "intensity", vmin=0.0, vmax=1.3)
    third.set_title("the whole field, as found")
    for letter, place in zip("defg", CROPS, strict=True):
        part = _crop(seen, place)
        x, y = (
            (a[0] - b[0]) / seen.light.pitch_mm
            for a, b in ((part.x_mm, seen.light.x_mm), (part.y_mm, seen.light.y_mm))
        )
        side = part.shape[0]
        third.plot([x, x + side, x + side, x, x], [y, y, y + side, y + side, y], color=RED, lw=1.0)
        third.text(x, y + side, letter, color=RED, va="bottom", fontsize=9)
    return figure


def _crop(seen: _Seen, place: tuple[float, float]) -> Grid:
    """The samples of a crop."""
    field_mm, grid = seen.one.imaged.patch.field_stop_mm, seen.light
    side = round(CROP_SHARE * field_mm / grid.pitch_mm)
    first = [
        round(0.5 * (n - side) + at * field_mm / grid.pitch_mm)
        for n, at in zip(grid.shape, place[::-1], strict=True)
    ]
    centre = tuple(
        float(axis[start] + 0.5 * (side - 1) * grid.pitch_mm)
        for axis, start in zip((grid.x_mm, grid.y_mm), first[::-1], strict=True)
    )
    return replace(grid, shape=(side, side), centre_mm=(centre[0], centre[1]))


def _crops(seen: _Seen) -> Figure:
    figure = styled_figure(10.6, 5.4)
    above, below = figure.subplots(2, 4)
    first = _crop(seen, CROPS[0])
    own = seen.found.with_values(np.abs(seen.found.values) ** 2)
    views = {"d1: from the frames": own.values}
    views |= {f"d2: {LOW.name}": seen.views["low"], f"d3: {HIGH.name}": seen.views["high"]}
    views |= {f"{HIGH.name}, coherent": seen.views["high, coherent"]}
    width_um = 1e3 * first.pitch_mm * first.shape[0]
    for axes, (name, values) in zip(above, views.items(), strict=True):
        shown = cut_field(own.with_values(values), first).values
        panel(figure, axes, np.real(shown), width_um, "µm", "intensity", vmin=0.0, vmax=1.3)
        axes.set_title(name)
    for axes, letter, place in zip(below, "efg", CROPS[1:], strict=False):
        panel(
            figure,
            axes,
            cut_field(own, _crop(seen, place)).values,
            width_um,
            "µm",
            "intensity",
            vmin=0.0,
            vmax=1.3,
        )
        axes.set_title(f"{letter}: from the frames")
    phase = np.angle(
        cut_field(seen.found, first).values
        * np.exp(-1j * np.angle(np.sum(cut_field(seen.found, first).values)))
    )
    panel(figure, below[-1], phase, width_um, "µm", "phase (rad)", "viridis", vmin=-0.5, vmax=1.5)
    below[-1].set_title("d: phase, as found")
    return figure


FIGURE_6 = Element(
    "figure-6",
    "Fig. 6: tissue over the whole field, and two objectives",
    "Mouse ovary over the field of 3 mm is reconstructed from two intensities. Cells appear as with a "
    "20× objective of NA 0.5, whose field is 1.25 mm wide. A 2× objective of NA 0.08 does not resolve "
    "them.",
    figure_6,
    SETTINGS,
    {"quick": 120.0, "full": 400.0},
)

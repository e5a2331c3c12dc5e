"""Fig. 5: one chart, with the lens, without it, and with a thin lens in its place."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from paper.drawing import draw_chart
from paper.element import Budget, Element, Made, Number, Work
from paper.focus import focused
from paper.lensless import lensless
from paper.shots import BRACKET, Shot, element_text, finest, retrieved_of, shot
from paper.style import BLUE, RED, faint_panel, styled_figure
from paper.twin import twin
from wavesim import (
    Field,
    ReconstructionSettings,
    SystemState,
    engine_for,
    propagate,
    reconstruct_frames,
)
from wavesim.reconstruction.refocusing import Refocusing
from wavesim.targets.region import around
from wavesim.targets.usaf import UsafElement, chart_outline, usaf_line_width_um

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FARTHER_UM = 1.0
"""By which the object is farther from the lens than 13.5 mm ask for: the paper finds 13.501 mm."""

LENSLESS_PIXELS, APART_MM = 416, 2.5
FINE_UM = 2.0
"""Elements of lines up to so wide are shown enlarged."""

SETTINGS: dict[Budget, dict[str, float]] = {
    "small": {"twin": 1 / 48, "iterations": 25, "lensless": 1 / 9},
    "quick": {"twin": 1 / 16, "iterations": 200, "lensless": 1 / 9},
    "full": {"twin": 1 / 8, "iterations": 500, "lensless": 1 / 8},
}


class _Without(NamedTuple):
    """Fig. 5e."""

    planes_mm: tuple[float, ...]
    found: Field
    elements: tuple[UsafElement, ...]


class _Panels(NamedTuple):
    """All that is drawn."""

    one: Shot
    vertex: Field
    focus: Refocusing
    paper: Field
    whole: Field
    without: _Without
    thin: Field


def figure_5(work: Work) -> Made:
    """Frames, field in the exit vertex plane, refocusing, and the object by three models."""
    scale, iterations = work.settings["twin"], int(work.settings["iterations"])
    work.progress("frames")
    one = shot(scale, "chart", BRACKET, farther_um=FARTHER_UM)
    work.progress(f"{iterations} iterations")
    run = retrieved_of(one, iterations)
    vertex = propagate(run.field, -one.lens.sensor.plane_distances_mm[0], check=False)
    back = one.object_of(run.field)
    work.progress("refocusing")
    focus, paper = focused(back, one.elements)
    work.progress("in the object domain")
    whole = _by_object(one, focus.distance_mm)
    light = one.light.with_values(one.light.values * whole.values)
    model = engine_for(one.case.engine.scene, "thin-lens", force=True)
    thin = model.adjoint(one.case.engine.forward(light))
    work.progress("without the lens")
    without = _without(work.settings["lensless"], iterations)
    panels = _Panels(one, vertex, focus, paper, whole, without, thin)
    pictures = (
        work.picture(_measured(panels), "a: light on both planes. b: exit vertex plane. c: SVFG."),
        work.picture(
            _objects(panels),
            "d: with the lens, by Appendix A and in the object domain. e: without the lens. f: thin lens. "
            "Below: the finest groups.",
            "objects",
        ),
    )
    return Made(
        _numbers(panels, float(np.ptp(work.lens.sensor.plane_distances_mm))),
        ("python -m paper --only figure-5",),
        DIFFERENCE,
        pictures,
    )


def _by_object(one: Shot, distance_mm: float) -> Field:
    """The chart in the object domain, the light taken where refocusing found the object."""
    chosen = one.imaged.settings
    settings = ReconstructionSettings(
        kind="amplitude",
        engine="eikonal",
        error=0.1,
        patch_mm=chosen.patch_mm,
        field_stop_mm=chosen.field_stop_mm,
        object_pitch_um=chosen.object_pitch_um,
        iterations=15,
    )
    there = SystemState(object_shift_mm=(0.0, 0.0, distance_mm))
    return reconstruct_frames(one.lens, one.imaged.frames, settings, calibration=there).transmission


def _without(scale: float, iterations: int) -> _Without:
    """The same chart in front of the sensor alone."""
    case = twin(scale)
    camera = lensless(case.lens, case.light, LENSLESS_PIXELS, case.lens.sensor.pixel_pitch_um, APART_MM)
    frames = camera.frames(case.transmission, seed=1)
    found = camera.object_of(camera.retrieved(frames, iterations).field)
    return _Without(camera.sensor.plane_distances_mm, found, case.elements)


def _numbers(panels: _Panels, apart: float) -> tuple[Number, ...]:
    one, focus, without = panels.one, panels.focus, panels.without
    nominal = one.lens.object.working_distance_mm
    return (
        Number("bits of a count", one.imaged.frames[0].settings.bits, "", 12),
        Number("distance between the planes, of the lens itself", apart, "mm", 20.0),
        Number(
            "working distance that refocusing finds, less the nominal one",
            -1e3 * focus.distance_mm,
            "µm",
            1.0,
            0.5,
            remark=_remark(panels),
        ),
        Number("the same, true value", FARTHER_UM, "µm"),
        Number("working distance of the twin, as found", nominal - focus.distance_mm, "mm", digits=6),
        Number(
            "peaks of SVFG within 1 % of the highest",
            (peaks := _peaks(focus)),
            "",
            1,
            remark="" if peaks == 1 else "coarse bars and twin images of the retrieval have their own",
        ),
        _resolves("with the lens, Appendix A", panels.paper, one.elements, (9, 2)),
        Number("correlation with the object, Appendix A", one.correlation(panels.paper)),
        _resolves("with the lens, in the object domain", panels.whole, one.elements, (9, 2)),
        Number("correlation with the object, in the object domain", _of_transmission(one, panels.whole)),
        _resolves("without the lens", without.found, without.elements, (7, 2)),
        Number("farther plane of the camera without a lens, from the object", without.planes_mm[1], "mm"),
        Number("with a thin lens: finest element", element_text(finest(panels.thin, one.elements))),
        Number("correlation with the object, thin lens", one.correlation(panels.thin)),
    )


def _remark(panels: _Panels) -> str:
    off = abs(-1e3 * panels.focus.distance_mm - 1.0)
    return "" if off <= 0.5 else f"{off:.2g} µm off; the depth of focus λ / NA² is 2.1 µm"


def _of_transmission(one: Shot, found: Field) -> float:
    light = one.light
    return one.correlation(light.with_values(light.values * found.values))


def _peaks(focus: Refocusing) -> int:
    curve = focus.svfg
    inner = curve[1:-1]
    return int(np.sum((inner > curve[:-2]) & (inner >= curve[2:]) & (inner > 0.99 * curve.max())))


def _resolves(what: str, found: Field, elements: tuple[UsafElement, ...], paper: tuple[int, int]) -> Number:
    """The finest element, beside the paper's."""
    here, said = (
        element_text(finest(found, elements)),
        f"{paper[0]}-{paper[1]}, {usaf_line_width_um(*paper):.3g} µm",
    )
    remark = "" if here == said else REMARKS[what]
    return Number(f"{what}: finest element", here, "", said, remark=remark)


REMARKS = {
    "with the lens, Appendix A": "lines are resolved, but the object is incomplete: two planes do not "
    "determine all of it",
    "with the lens, in the object domain": "finer: the finest lines that the samples of the object resolve",
    "without the lens": "the limit of the pixels' 156 lp/mm",
}
DIFFERENCE = (
    "The lens is a twin with the paper's pixels and angles. Frames are brackets of three exposures of 12 "
    "bits on two planes. From them Appendix A gives lines but not the whole object; the next elements "
    "show its requirements. The object-domain method gives the whole object, with finer lines. The SVFG "
    "of the result of Appendix A has one peak, and finds the object within a depth of focus, 2.1 µm. "
    "Without the lens, the sensor is placed where it receives, from the whole field, the steepest light "
    "that its pixels resolve. The pixels' 156 lp/mm lie between elements 2 and 3 of group 7. The thin "
    "lens gets the light of the object-domain result, and fine lines are lost. Aberrations shrink with "
    "the twin, so coarser lines survive here."
)


def _measured(panels: _Panels) -> Figure:
    one, focus = panels.one, panels.focus
    figure = styled_figure(10.0, 2.9)
    first, second, third, last = figure.subplots(1, 4, width_ratios=(1.0, 1.0, 1.0, 1.1))
    pitch_mm = 1e-3 * one.lens.sensor.pixel_pitch_um
    shown = [(np.square(plane.amplitude), "intensity") for plane in one.case.recorded]
    shown.append((np.abs(panels.vertex.values), "amplitude"))
    names = (*(f"plane at {z:.3g} mm" for z in one.lens.sensor.plane_distances_mm), "exit vertex plane")
    for axes, (values, quantity), name in zip((first, second, third), shown, names, strict=True):
        faint_panel(figure, axes, values, pitch_mm * values.shape[1], quantity, 5.0)
        axes.set_title(name)
    _curve(last, focus)
    return figure


def _curve(axes: Axes, focus: Refocusing) -> None:
    at = -1e3 * focus.distances_mm
    axes.plot(at, focus.svfg / focus.svfg.max(), color=BLUE)
    found = -1e3 * focus.distance_mm
    axes.axvline(found, color=RED, lw=1.0)
    axes.annotate(
        f"{round(found, 2) + 0.0:.2f} µm",  # not -0.00
        (found, 1.0),
        (6, 0),
        textcoords="offset points",
        va="top",
        color=RED,
        fontsize=8,
    )
    axes.set(xlabel="working distance − nominal (µm)", ylabel="SVFG over the largest", title="refocusing")


def _objects(panels: _Panels) -> Figure:
    one, without = panels.one, panels.without
    figure = styled_figure(10.6, 5.2)
    shown: list[tuple[str, Field, tuple[UsafElement, ...], float]] = [
        ("d: Appendix A", panels.paper, one.elements, FINE_UM),
        ("d: object domain", panels.whole, one.elements, FINE_UM),
        ("e: without the lens", without.found, without.elements, FINE_UM),
        ("f: thin lens", panels.thin, one.elements, FINE_UM),
    ]
    for column, (name, field, elements, fine_um) in zip(figure.subplots(2, 4).T, shown, strict=True):
        few = tuple(e for e in elements if e.line_width_um <= fine_um) or elements
        for axes, part in zip(column, (elements, few), strict=True):
            draw_chart(figure, axes, field, part)
        _group_labels(column[1], few, field)
        column[0].set_title(name)
    return figure


def _group_labels(axes: Any, elements: tuple[UsafElement, ...], field: Field) -> None:
    """The number of each group at its first element."""
    outline, pitch = around(chart_outline(elements), field.grid), field.grid.pitch_mm
    for group in sorted({e.group for e in elements}):
        first = max((e for e in elements if e.group == group), key=lambda e: e.line_width_um)
        x = (first.centre_mm[0] - 8e-3 * first.line_width_um - outline.x_mm[0]) / pitch
        y = (first.centre_mm[1] - outline.y_mm[0]) / pitch
        axes.text(x, y, str(group), color=RED, fontsize=8, ha="center", va="center")


FIGURE_5 = Element(
    "figure-5",
    "Fig. 5: the test chart, with and without the lens",
    "From two 12-bit intensities, 20 mm apart, SVFG has one peak at a working distance of 13.501 mm, and "
    "group 9, element 2 (0.87 µm) is resolved. Without the lens, group 7, element 2 (3.5 µm) is "
    "resolved, the limit of the pixels. With a thin lens in the model the object is very blurred.",
    figure_5,
    SETTINGS,
    {"quick": 90.0, "full": 200.0},
)

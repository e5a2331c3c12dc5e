"""Appendices A and C at their best: which frames they want, and what the way back through slices costs."""

from __future__ import annotations

from dataclasses import replace
from textwrap import fill
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from paper.drawing import draw_chart
from paper.element import Budget, Element, Made, Number, Work
from paper.shots import BRACKET, ONE, Shot, element_text, finest, shot
from paper.style import styled_figure
from wavesim import Engine, Field, Measurement, engine_for, propagate
from wavesim.reconstruction.resumable import retrieve_resumably
from wavesim.sensor.sensor import light_on_pixels
from wavesim.targets.usaf import usaf_line_width_um

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PAPER_SLICES = 200
SETTINGS: dict[Budget, dict[str, float]] = {
    "small": {"twin": 1 / 48, "iterations": 50, "slices": 4, "kinds": 2},
    "quick": {"twin": 1 / 32, "iterations": 300, "slices": PAPER_SLICES, "kinds": 5},
    "full": {"twin": 1 / 12, "iterations": 500, "slices": PAPER_SLICES, "kinds": 5},
}
SLICED_TWIN = 1 / 48
"""Of the ways back: slices take fine samples over all of the lens."""

ROUNDS = 4
"""In which amplitudes are freed of what pixels average."""

MOST_RATIO = 10.0


class _Taken(NamedTuple):
    """Frames, and how they are read."""

    said: str
    exposures: tuple[float, ...]
    planes: int
    fill_factor: float = 1.0
    rounds: int = 1


TAKEN = (
    _Taken("one exposure, two planes: the paper's", ONE, 2),
    _Taken("three exposures, two planes", BRACKET, 2),
    _Taken("three exposures, four planes", BRACKET, 4),
    _Taken("the same, pixels undone in four rounds", BRACKET, 4, rounds=ROUNDS),
    _Taken("the same, pixels that are points", BRACKET, 4, 0.0),
)


def the_papers_way(work: Work) -> Made:
    """Frames of several kinds, and ways back of one field."""
    scale, iterations = work.settings["twin"], int(work.settings["iterations"])
    numbers, drawn = list[Number](), dict[str, tuple[Shot, Field]]()
    for kind in np.linspace(0, len(TAKEN) - 1, int(work.settings["kinds"])).astype(int):
        taken = TAKEN[kind]
        work.progress(taken.said)
        one = shot(scale, "chart", taken.exposures, taken.planes, fill_factor=taken.fill_factor)
        found = one.object_of(_retrieved(one, iterations, taken.rounds))
        numbers += _of(taken.said, one, found)
        drawn[taken.said] = one, found
    sliced, field = _best_field(iterations)
    as_thick = max(1, round(PAPER_SLICES * SLICED_TWIN))
    for said, back in _ways_back(sliced, as_thick, int(work.settings["slices"])).items():
        work.progress(said)
        found = sliced.object_of(field, back)
        numbers += _of(said, sliced, found)
        drawn[said] = sliced, found
    picture = work.picture(
        _objects(drawn),
        "Amplitude of the chart. Above: for different frames. Below: one field, for different "
        "back-propagations.",
    )
    return Made(tuple(numbers), COMMANDS, DIFFERENCE, (picture,))


def _of(said: str, one: Shot, found: Field) -> list[Number]:
    element = finest(found, one.elements)
    there = element is not None and element.line_width_um <= usaf_line_width_um(9, 2) * (1.0 + 1e-9)
    here = "yes" if there else "no"
    remark = "" if there else f"down to {element_text(element)}" if element else "nor is any other"
    return [
        Number(f"9-2 resolved: {said}", here, "", "yes", remark=remark),
        Number(f"correlation with the object: {said}", one.correlation(found)),
    ]


def _retrieved(one: Shot, iterations: int, rounds: int) -> Field:
    """Appendix A; in further rounds, amplitudes are those of points, by what the round before found."""
    case = one.case
    each = iterations // rounds
    found = retrieve_resumably(case.engine, case.light, case.recorded, iterations=each)[0].field
    for _ in range(rounds - 1):
        planes = [_at_points(one, plane, found) for plane in case.recorded]
        found = retrieve_resumably(case.engine, case.light, planes, iterations=each)[0].field
    return found


def _at_points(one: Shot, plane: Measurement, found: Field) -> Measurement:
    """An amplitude in the middles of pixels, from its mean over them."""
    there = propagate(found, plane.distance_mm, check=False) if plane.distance_mm else found
    down, across = there.grid.shape
    sensor = one.lens.sensor.model_copy(update={"pixels": (across, down)})
    mean = light_on_pixels(there, sensor, fill_factor=1.0)
    ratio = np.sqrt(np.abs(there.values) ** 2 / np.maximum(mean, 1e-30))
    ratio = np.clip(ratio, 1.0 / MOST_RATIO, MOST_RATIO)
    return replace(plane, amplitude=np.asarray(plane.amplitude * ratio, plane.amplitude.dtype))


def _best_field(iterations: int) -> tuple[Shot, Field]:
    """What Appendix A finds of the best frames, on the twin whose lens is cut into slices."""
    one = shot(SLICED_TWIN, "chart", BRACKET, 4, fill_factor=0.0)
    return one, _retrieved(one, iterations, 1)


def _ways_back(one: Shot, as_thick: int, most: int) -> dict[str, Engine]:
    """Engines that carry a field back."""
    scene = one.case.engine.scene
    found: dict[str, Engine] = {}
    for slices, compensation in ((as_thick, "vertical"), (most, "vertical"), (as_thick, "oblique")):
        said = f"back by {slices} {compensation} slices"
        if slices == as_thick:
            said += ", as thick as the paper's 200"
        found[said] = engine_for(scene, "slices", slices=slices, compensation=compensation, force=True)
    found["back by the eikonal engine"] = one.case.engine
    return found


DIFFERENCE = (
    "From frames with the paper's exposure, Appendix A does not reach Fig. 5d. The light of fine lines "
    "is below the read noise, and two planes at these distances allow other fields. It requires "
    "exposures of 1, 30 and 1000, so that faint light is known; four planes instead of two; and "
    "amplitudes of points. A2 replaces the value in the middle of a pixel by its mean, which is wrong "
    "for fringes of two pixels. With all three, the whole object is retrieved. The integration over "
    "pixels can be corrected in part, by repeatedly dividing by its effect on the retrieved field. The "
    "field stop as a support between these repetitions gains next to nothing. For the back-propagation, "
    "the thickness of slices matters, so the lens's 200 slices are 4 on a twin 48 times as small. With "
    "slices of this thickness, vertical compensation loses all fine lines, and oblique does not. "
    "Vertical slices 48 times as thin are as good as the eikonal engine."
)

COMMANDS = ("python -m paper --only the-papers-way",)


def _objects(drawn: dict[str, tuple[Shot, Field]]) -> Figure:
    figure = styled_figure(11.6, 5.0)
    all_axes = list(figure.subplots(2, 5).flat)
    for axes, (said, (one, found)) in zip(all_axes, drawn.items(), strict=False):
        draw_chart(figure, axes, found, one.elements)
        axes.set_title(fill(said, 24), fontsize=8)
    for axes in all_axes[len(drawn) :]:
        axes.set_visible(False)
    return figure


THE_PAPERS_WAY = Element(
    "the-papers-way",
    "Appendices A and C at their best: what Fig. 5d takes",
    "Fig. 5d resolves group 9, element 2 from two 12-bit intensities, with 500 iterations from the "
    "forward model's field and 200 slices of each surface for the back-propagation.",
    the_papers_way,
    SETTINGS,
    {"quick": 120.0, "full": 900.0},
)
"""Not one of the paper's figures, but what becomes of all its steps together."""

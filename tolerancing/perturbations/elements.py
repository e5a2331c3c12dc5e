"""Glass elements that move as one, and surfaces that are wedged, as deltas of their surfaces.

An element that turns takes its surfaces along: each turns by the same angles about its own vertex, and its
vertex moves on a circle about the pivot. Wedge is a tilt, stated by what a shop reads: the total indicator
runout of a surface, or the difference of edge thickness of an element.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.lens.lens import Lens
from lensdesign.lens.poses import Pose
from lensdesign.lens.solid import mechanical_semi_diameter_mm
from tolerancing.perturbations.parameters import (
    EDGE_DIFFERENCES,
    ROLLS,
    RUNOUTS,
    TILTS,
    PerturbedParameter,
)

Delta = tuple[int, str, Any]
"""Index of a surface, name of a delta of a surface, and its values."""


def element_deltas(lens: Lens, parameters: Sequence[PerturbedParameter], values: Array) -> Iterator[Delta]:
    """What perturbed elements do to their surfaces.

    Tilts about x and y with the same seat make one rotation, about x and then about the turned y axis; what
    else moves an element adds up.

    Parameters
    ----------
    lens
        The nominal lens.
    parameters, values
        Of a batch: columns, and deltas of shape (trials, parameters).
    """
    rotations: dict[tuple[int, float], dict[str, Array]] = {}
    for column, parameter in enumerate(parameters):
        if parameter.element is None:
            continue
        value, front = values[:, column], lens.glass_fronts[parameter.element]
        if parameter.parameter in EDGE_DIFFERENCES:
            reach = mechanical_semi_diameter_mm(lens, parameter.element)
            yield front + 1, *wedge_tilt(parameter.parameter, value, reach)
        elif parameter.parameter in (*TILTS, *ROLLS):
            own = rotations.setdefault((parameter.element, _pivot_z_mm(lens, parameter)), {})
            name = parameter.parameter.replace("roll", "tilt")
            own[name] = own.get(name, 0.0) + value
        else:
            for surface in (front, front + 1):
                yield surface, parameter.parameter, value
    for (element, pivot), tilts in rotations.items():
        yield from _turned(lens, lens.glass_fronts[element], pivot, tilts)


def wedge_tilt(name: str, difference_mm: Array, reach_mm: float) -> tuple[str, Array]:
    """The tilt by which one rim of a surface lies farther along z than the opposite one.

    Parameters
    ----------
    name
        Of a parameter with ``_x_`` or ``_y_``: the axis along which the rims lie.
    difference_mm
        z of the rim at positive x (or y) less that at negative.
    reach_mm
        Radial height of both rims.
    """
    angle = np.rad2deg(np.arcsin(np.clip(difference_mm / (2.0 * reach_mm), -1.0, 1.0)))
    # Right-handed: a turn about x raises the rim at positive y, one about y lowers that at positive x.
    return ("tilt_x_deg", angle) if "_y_" in name else ("tilt_y_deg", -angle)


def runout_tilt(lens: Lens, surface: int, name: str, value: Array) -> tuple[str, Array]:
    """The tilt of a surface that runs out by so much at its clear semi-diameter."""
    assert name in RUNOUTS
    reach = lens.surfaces[surface].semi_diameter_mm
    assert reach is not None  # the study's check saw to it
    return wedge_tilt(name, value, reach)


def _pivot_z_mm(lens: Lens, parameter: PerturbedParameter) -> float:
    """Where on the axis an element turns, from the front vertex of the lens."""
    assert parameter.element is not None
    front = lens.glass_fronts[parameter.element]
    if isinstance(parameter.seat, float):
        return float(lens.vertex_z_mm[front]) + parameter.seat
    surface = front if parameter.seat == "front" else front + 1
    vertex, radius = float(lens.vertex_z_mm[surface]), lens.surfaces[surface].radius_mm
    if parameter.parameter not in ROLLS:
        return vertex
    assert radius is not None  # the study's check saw to it
    return vertex + radius


def _turned(lens: Lens, front: int, pivot_z_mm: float, tilts: dict[str, Array]) -> Iterator[Delta]:
    rotation, shift = Pose(pivot_z_mm=pivot_z_mm, **tilts).transform()
    for surface in (front, front + 1):
        z = float(lens.vertex_z_mm[surface])
        moved = rotation[:, :, 2] * z + shift - [0.0, 0.0, z]
        for name, along in zip(("decenter_x_mm", "decenter_y_mm", "despace_mm"), moved.T, strict=True):
            yield surface, name, along
        for name, angle in tilts.items():
            yield surface, name, angle

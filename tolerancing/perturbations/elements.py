"""Perturbations of glass elements and wedge of surfaces, expressed as deltas of surfaces.

A tilted element tilts both of its surfaces: each surface tilts by the same angles about its own vertex, and
its vertex moves on a circle about the pivot. Wedge is a tilt that is stated by the quantity that a workshop
measures: the total indicator runout of a surface, or the difference of edge thickness of an element.
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
"""Index of a surface, name of a surface delta, and its values."""


def element_deltas(lens: Lens, parameters: Sequence[PerturbedParameter], values: Array) -> Iterator[Delta]:
    """Yield the deltas of surfaces that follow from perturbed elements.

    Tilts about x and y with the same seat make one rotation, first about x and then about the rotated y axis.
    All other deltas of an element add up.

    Parameters
    ----------
    lens
        The nominal lens.
    parameters : sequence of PerturbedParameter
        Columns of the batch.
    values : ndarray, shape (trials, parameters)
        Deltas of the batch.

    Yields
    ------
    tuple
        Surface index, name of the delta, and values of shape (trials,).
    """
    rotations: dict[tuple[int, float], dict[str, Array]] = {}
    for column, parameter in enumerate(parameters):
        if parameter.element is None:
            continue
        value, front = values[:, column], lens.glass_fronts[parameter.element]
        if parameter.parameter in EDGE_DIFFERENCES:
            edge_height = mechanical_semi_diameter_mm(lens, parameter.element)
            yield front + 1, *wedge_tilt(parameter.parameter, value, edge_height)
        elif parameter.parameter in (*TILTS, *ROLLS):
            own = rotations.setdefault((parameter.element, _pivot_z_mm(lens, parameter)), {})
            name = parameter.parameter.replace("roll", "tilt")
            own[name] = own.get(name, 0.0) + value
        else:
            for surface in (front, front + 1):
                yield surface, parameter.parameter, value
    for (element, pivot), tilts in rotations.items():
        yield from _tilted_surfaces(lens, lens.glass_fronts[element], pivot, tilts)


def wedge_tilt(name: str, difference_mm: Array, edge_height_mm: float) -> tuple[str, Array]:
    """Return the tilt of a surface whose opposite edges differ in z.

    Parameters
    ----------
    name
        Name of the parameter. Its ``_x_`` or ``_y_`` names the axis along which the two edges lie.
    difference_mm : ndarray, shape (trials,)
        z of the edge at positive x (or y) minus z of the edge at negative x (or y).
    edge_height_mm
        Distance of both edges from the axis.

    Returns
    -------
    name : str
        ``tilt_x_deg`` or ``tilt_y_deg``.
    angle_deg : ndarray, shape (trials,)
        The tilt.
    """
    angle = np.rad2deg(np.arcsin(np.clip(difference_mm / (2.0 * edge_height_mm), -1.0, 1.0)))
    # Right-handed: a tilt about x raises the edge at positive y; a tilt about y lowers that at positive x.
    return ("tilt_x_deg", angle) if "_y_" in name else ("tilt_y_deg", -angle)


def runout_tilt(lens: Lens, surface: int, name: str, value: Array) -> tuple[str, Array]:
    """Return the tilt of a surface from its total indicator runout in mm at the clear semi-diameter."""
    assert name in RUNOUTS
    semi_diameter = lens.surfaces[surface].semi_diameter_mm
    assert semi_diameter is not None  # guaranteed by PerturbedParameter.check
    return wedge_tilt(name, value, semi_diameter)


def _pivot_z_mm(lens: Lens, parameter: PerturbedParameter) -> float:
    """Return the position on the axis about which an element tilts, from the front vertex of the lens."""
    assert parameter.element is not None
    front = lens.glass_fronts[parameter.element]
    if isinstance(parameter.seat, float):
        return float(lens.vertex_z_mm[front]) + parameter.seat
    surface = front if parameter.seat == "front" else front + 1
    vertex, radius = float(lens.vertex_z_mm[surface]), lens.surfaces[surface].radius_mm
    if parameter.parameter not in ROLLS:
        return vertex
    assert radius is not None  # guaranteed by PerturbedParameter.check
    return vertex + radius


def _tilted_surfaces(lens: Lens, front: int, pivot_z_mm: float, tilts: dict[str, Array]) -> Iterator[Delta]:
    """Yield the deltas of the two surfaces of an element that tilts about a point on the axis."""
    rotation, shift = Pose(pivot_z_mm=pivot_z_mm, **tilts).transform()
    for surface in (front, front + 1):
        z = float(lens.vertex_z_mm[surface])
        moved = rotation[:, :, 2] * z + shift - [0.0, 0.0, z]
        for name, along in zip(("decenter_x_mm", "decenter_y_mm", "despace_mm"), moved.T, strict=True):
            yield surface, name, along
        for name, angle in tilts.items():
            yield surface, name, angle

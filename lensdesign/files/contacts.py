"""Surfaces of other programs' files that touch, or that cross where no light passes.

Other programs trace rays from one surface to the next whatever lies between them. The surfaces of a design
are bodies: they have a distance, and do not cross within their clear apertures.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from lensdesign.errors import InputError
from lensdesign.files.draft import Draft, SurfaceRow
from lensdesign.files.marginal_ray import MeridionalSystem
from lensdesign.lens.shapes.base import Shape, axial_gaps_mm

CONTACT_GAP_MM = 1e-6
"""Distance of surfaces that touch at their vertices; its effect on light is below any tolerance."""

_RAYS = 201  # of each object point across the first surface
_BEAM_MARGIN = 1.01  # the outermost of these rays is within 1 % of the edge of the beam


def read_contacts(rows: Sequence[SurfaceRow], draft: Draft) -> list[SurfaceRow]:
    """Return the rows with a distance of `CONTACT_GAP_MM` between surfaces that touch at their vertices."""
    result = list(rows)
    for i, (row, behind) in enumerate(pairwise(rows[1:-1]), start=1):
        if row.thickness_mm != 0.0:
            continue
        result[i] = replace(row, thickness_mm=CONTACT_GAP_MM)
        draft.add_remark(
            f"{row.name} and {behind.name} touch at their vertices (distance 0); they are read with a "
            f"distance of {1e6 * CONTACT_GAP_MM:g} nm"
        )
    return result


def without_crossings(
    rows: Sequence[SurfaceRow],
    draft: Draft,
    system: MeridionalSystem,
    object_distance_mm: float,
    half_field_mm: float,
) -> list[SurfaceRow]:
    """Return the rows with clear semi-diameters within which consecutive surfaces do not cross.

    A crossing outside the beam causes a remark, one within the beam a loss.

    Parameters
    ----------
    rows
        Surfaces of the file, with the object and the image.
    draft
        Contents of the file, which gets the remarks and losses.
    system
        The surfaces between object and image for exact rays.
    object_distance_mm, half_field_mm
        Distance of the object from the first surface, and its radius.

    Raises
    ------
    InputError
        If surfaces cross next to the axis.
    """
    crossings = []
    for i, (row, behind) in enumerate(pairwise(rows[1:-1])):
        semis = [r.semi_diameter_mm for r in (row, behind) if r.semi_diameter_mm is not None]
        if not semis or not 0.0 < row.thickness_mm < math.inf:
            continue
        height = _crossing_height(system.shapes[i], system.shapes[i + 1], row.thickness_mm, min(semis))
        if height is not None:
            crossings.append((i, height))
    if not crossings:
        return list(rows)
    semi_mm = [row.semi_diameter_mm for row in rows[1:-1]]
    beam = _beam_heights(system, object_distance_mm, half_field_mm, semi_mm)
    result = list(rows)
    for i, height in crossings:
        row, behind = rows[i + 1], rows[i + 2]
        reached = _BEAM_MARGIN * max(beam[i : i + 2])
        names = f"{row.name} and {behind.name} cross {height:.6g} mm from the axis"
        if height < 0.05 * reached:
            needed = row.thickness_mm - _smallest_gap(
                system.shapes[i], system.shapes[i + 1], row.thickness_mm, reached
            )
            stated = 0.0 if row.thickness_mm == CONTACT_GAP_MM else row.thickness_mm
            raise InputError(
                f"{row.location}: {names}, where the beam reaches {reached:.6g} mm: their distance is "
                f"{stated:.6g} mm; make it at least {needed:.6g} mm in the file"
            )
        if reached < height:
            clear = reached + 0.9 * (height - reached)
            draft.add_remark(
                f"{names}, outside of the beam of {reached:.6g} mm; their clear semi-diameters of more than "
                f"{clear:.6g} mm are read as {clear:.6g} mm"
            )
        else:
            clear = 0.99 * height
            draft.add_loss(
                f"{names}, within the beam of {reached:.6g} mm: semi-diameters of {clear:.6g} mm clip it"
            )
        for j in (i + 1, i + 2):
            semi = result[j].semi_diameter_mm
            if semi is not None and semi > clear:
                result[j] = replace(result[j], semi_diameter_mm=clear)
    return result


def _crossing_height(
    front: Shape, behind: Shape, distance_mm: float, semi_diameter_mm: float
) -> float | None:
    """Return the smallest height at which two surfaces cross within a semi-diameter; None if none."""
    heights = np.linspace(0.0, semi_diameter_mm, 257)  # as of the check of a lens
    crossed = axial_gaps_mm(front, behind, distance_mm, heights) <= 0.0
    if not np.any(crossed):
        return None
    return float(heights[max(int(np.argmax(crossed)) - 1, 0)])


def _smallest_gap(front: Shape, behind: Shape, distance_mm: float, semi_diameter_mm: float) -> float:
    heights = np.linspace(0.0, semi_diameter_mm, 257)
    return float(np.nanmin(axial_gaps_mm(front, behind, distance_mm, heights)))


def _beam_heights(
    system: MeridionalSystem,
    object_distance_mm: float,
    half_field_mm: float,
    semi_diameters_mm: Sequence[float | None],
) -> list[float]:
    """Return the largest height at each surface of meridional rays that pass all apertures.

    The rays come from the object point on the axis and from the one at the edge of the field.
    """
    reach = max([s for s in semi_diameters_mm if s is not None], default=0.0)
    largest = [0.0] * len(system.shapes)
    for field_mm in (0.0, half_field_mm):
        for target in np.linspace(-reach, reach, _RAYS):
            sine = math.sin(math.atan2(float(target) - field_mm, object_distance_mm))
            ray = system.trace(field_mm, -object_distance_mm, sine)
            if ray is None:
                continue
            heights = [abs(height) for height in ray.heights_mm]
            if all(s is None or h <= s for h, s in zip(heights, semi_diameters_mm, strict=True)):
                largest = [max(pair) for pair in zip(largest, heights, strict=True)]
    return largest

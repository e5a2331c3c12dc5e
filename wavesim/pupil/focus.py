"""Search of the focus in which a reconstruction has the highest score, such as contrast.

:func:`wavesim.refocus` makes the phase as flat as possible in the least-squares sense. Contrast or a Strehl
ratio may be higher in another plane, which refocusing by eye or by a merit finds.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.errors import SamplingError
from wavesim.pupil.pupil import PupilGrid, ReconstructionPupil, Refocused

FOCUS_RANGE = 1.5
"""Largest distance of the best focus from the pupil's plane, to either side, in wavelength / NA^2."""

STEPS = 4
"""Number of trial planes to either side. A parabola interpolates between the best one and its neighbours."""


KEPT_SAMPLES = 2**18
"""Largest number of samples of a pupil whose planes are kept.

A search has about a dozen planes, each with what scores compute from it.
"""


class FocalPlanes:
    """A registered pupil in planes along the axis, which several scores can share.

    Planes of pupils with more than `KEPT_SAMPLES` are made again for each score, to save memory.

    Parameters
    ----------
    pupil
        The pupil (:func:`wavesim.refocus`).
    """

    def __init__(self, pupil: ReconstructionPupil) -> None:
        self.pupil = pupil
        self.slopes, self._across = axial_path(pupil)
        self._moved = {0.0: pupil}

    def at(self, distance_um: float) -> ReconstructionPupil:
        """Return the pupil in the plane at a distance; its lateral position does not change."""
        if distance_um in self._moved:
            return self._moved[distance_um]
        path = self.pupil.opd_mm + 1e-3 * distance_um * self._across
        moved = replace(self.pupil, opd_mm=path)
        if path.size <= KEPT_SAMPLES:
            self._moved[distance_um] = moved
        return moved


def best_focus(
    pupil: ReconstructionPupil | FocalPlanes, score: Callable[[ReconstructionPupil], float]
) -> Refocused:
    """Return the pupil in the object plane with the highest score; its lateral position does not change.

    Parameters
    ----------
    pupil
        A registered pupil (:func:`wavesim.refocus`), or its planes if several scores are searched. The search
        covers `FOCUS_RANGE` to either side of its plane.
    score
        Function of a pupil; the best pupil has the highest score. Planes in which it raises a SamplingError
        are skipped.

    Returns
    -------
    Refocused
        The pupil, and the shift and refocus distance in addition to those that were removed before.

    Raises
    ------
    SamplingError
        If the score cannot be computed in the plane of the given pupil.
    """
    planes = pupil if isinstance(pupil, FocalPlanes) else FocalPlanes(pupil)
    grid = planes.pupil.grid
    distance, _ = search_maximum(lambda distance_um: score(planes.at(distance_um)), search_range_um(grid))
    shift = -distance * planes.slopes[1:]
    return Refocused(
        pupil=planes.at(distance),
        shift_um=shift,
        refocus_um=distance,
        piston_um=float(distance * planes.slopes[0] + np.append(shift, distance) @ grid.mean_cosines),
    )


def search_range_um(grid: PupilGrid) -> float:
    """Return the largest distance in um, from the nominal focus, at which the best focus is searched."""
    return FOCUS_RANGE * grid.wavelength_um / grid.half_width**2


def axial_path(pupil: ReconstructionPupil) -> tuple[Array, Array]:
    """Return the path change for a unit shift of the plane along the axis, without piston and shift.

    Returns
    -------
    slopes : ndarray, shape (3,)
        Coefficients of piston, x and y that were removed from the axial cosine.
    path : ndarray, shape (n,)
        Remaining path change at the samples; 0 where they are not valid.
    """
    basis, valid = pupil.grid.basis, pupil.valid
    # On a line one of the cosines is 0 everywhere, and has no slope.
    products = pupil.products[:3]
    slopes = np.asarray(np.linalg.lstsq(products[:, :3], products[:, 3], rcond=None)[0], float)
    return slopes, np.where(valid, basis[3] - slopes @ basis[:3], 0.0)


def search_maximum(score: Callable[[float], float], range_um: float) -> tuple[float, float]:
    """Return the distance within a range to either side of 0 at which a score is highest, and the score.

    `STEPS` points to either side give the approximate position; a parabola through the best point and its
    neighbours refines it.
    """

    def tolerant(distance: float) -> float:
        try:
            return score(distance)
        except SamplingError:
            if distance == 0.0:
                raise
            return -np.inf

    distances = range_um * np.arange(-STEPS, STEPS + 1) / STEPS
    scores = np.array([tolerant(float(distance)) for distance in distances])
    best = int(np.argmax(scores))
    position, highest = float(distances[best]), float(scores[best])
    if 0 < best < 2 * STEPS and np.all(np.isfinite(scores[best - 1 : best + 2])):
        before, here, after = scores[best - 1 : best + 2]
        bend = before - 2.0 * here + after
        if bend < 0.0:
            vertex = position + 0.5 * (before - after) / bend * range_um / STEPS
            at_vertex = tolerant(vertex)
            if at_vertex > highest:
                position, highest = vertex, at_vertex
    return position, highest

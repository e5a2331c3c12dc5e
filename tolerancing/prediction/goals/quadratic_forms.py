"""Mean squares of wavefronts as quadratic forms of perturbations and compensators, with derivatives."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.errors import DesignError
from lensdesign.optimization.problem import Rays
from lensdesign.raytrace.bundles import pupil_rings
from tolerancing.prediction.derivatives import (
    ARMS,
    RINGS,
    FieldDifferentials,
    basis_of,
    first_by,
    weights_over_stop,
)
from tolerancing.prediction.goals.design import STEP, DesignPoint, TracedRays
from tolerancing.prediction.paths import Paths, SagErrors
from tolerancing.prediction.system import Changes


def wavefront_forms(design: DesignPoint, points_mm: Sequence[tuple[float, float]]) -> tuple[Array, Array]:
    """Return quadratic forms whose values are mean squares of the refocused path difference, in waves.

    Parameters
    ----------
    design
    points_mm
        Object points.

    Returns
    -------
    values : ndarray, shape (p, d + k, d + k)
        Forms of the amounts of the changes and the values of the compensators.
    by : ndarray, shape (v, p, d + k, d + k)
        Derivatives by the variables in their own units.

    Raises
    ------
    DesignError
        If rays from an object point do not all pass.
    """
    stop = pupil_rings(RINGS, ARMS)
    fields = np.repeat(np.array(points_mm, float).reshape(-1, 2), len(stop.points), axis=0)
    rays = Rays(fields, np.tile(stop.points, (len(points_mm), 1)))
    traced = TracedRays(design, rays, design.scatter.study.sampling.plane_distance_mm)
    if not np.all(traced.ok):
        raise DesignError("rays from the object points do not all pass the lens")

    def forms(paths: Paths, changes: Changes, sag_errors: list[SagErrors], multiplier: Array) -> Array:
        waves = 1e3 / design.wavelength_um
        slopes = waves * first_by(paths, changes, sag_errors) * multiplier
        cosines, n, found = paths.cosines, len(stop.points), []
        for k in range(len(points_mm)):
            part = slice(k * n, (k + 1) * n)
            field = FieldDifferentials(
                weights_over_stop(cosines[part], stop),
                basis_of(cosines[part]),
                slopes[part],
                np.zeros((n, 0)),
            )
            found.append((field.registered.T * field.weights) @ field.registered)
        return np.stack(found)

    values = forms(
        traced.nominal_paths, design.changes, design.sag_errors(traced.nominal_paths), design.multiplier
    )
    by = np.empty((len(design.variables), *values.shape))
    for v in range(len(design.variables)):
        paths, (changes, multiplier) = traced.moved(v), design.moved_changes(v)
        sag_errors = design.moved_sag_errors(paths, traced.nominal_paths, v)
        by[v] = forms(paths, changes, sag_errors, multiplier).imag / STEP
    return values, by

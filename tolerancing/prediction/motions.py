"""Elementary motions that make up the changes of a lens, and second derivatives of paths by them.

A change rotates and shifts the object, surfaces and sensor, and alters terms of shapes, indices, sag errors
and the wavelength. It is a sparse combination of these motions, of which there are few. Dense second
derivatives of paths are computed by the motions only; the chain rule converts them to derivatives by the
changes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse

from lensdesign.common.arrays import Array
from lensdesign.lens.shapes.base import Shape
from tolerancing.prediction.paths import POSE, Paths, SagErrors
from tolerancing.prediction.system import Changes


@dataclass(frozen=True, eq=False)
class Motions:
    """Response of n rays to q motions of a lens with s surfaces.

    The motions are, in this order: rotations about x, y and z in radians and shifts of each station; terms of
    the shapes; indices; the ratio of wavelengths; and the amplitude of each sag error.

    Attributes
    ----------
    paths : Paths
        Nominal paths of the rays.
    sag_errors : sequence of SagErrors
        Sag errors that changes cause.
    """

    paths: Paths
    sag_errors: Sequence[SagErrors] = ()

    @cached_property
    def _first_term(self) -> int:
        return 6 * (self.paths.layout.surfaces + 2)

    def _position(self, parameters: slice) -> slice:
        """Return the motions that are system parameters, for a slice of those behind the poses."""
        shift = self._first_term - POSE * (self.paths.layout.surfaces + 2)
        return slice(parameters.start + shift, parameters.stop + shift)

    @cached_property
    def _indices(self) -> slice:
        return self._position(self.paths.layout.indices)

    @cached_property
    def count(self) -> int:
        """Number of motions."""
        return self._indices.stop + 1 + sum(one.sag.shape[1] for one in self.sag_errors)

    @cached_property
    def _sags(self) -> list[tuple[int, slice, Array]]:
        """Surface, motions and sag with slopes, shape (n, 3, motions), of each shape and sag error."""
        paths, layout = self.paths, self.paths.layout
        found = []
        for k, shape in enumerate(paths.shapes):
            terms = [np.stack(paths.term_derivatives(k, t), axis=1) for t in shape.TERMS[: layout.terms[k]]]
            found.append((k, self._position(layout.of_shape(k)), np.stack(terms, axis=2)))
        place = self._indices.stop + 1
        for one in self.sag_errors:
            parts = np.stack([one.sag, one.slope_x, one.slope_y], axis=1)
            found.append((one.surface, slice(place, place + parts.shape[2]), parts))
            place += parts.shape[2]
        return found

    @cached_property
    def points(self) -> Array:
        """Displacement of the stations' points at fixed ray heights, shape (n, 3 (s + 2), q)."""
        own = self.paths.own_points
        n, stations = own.shape[:2]
        kinds = (own, *(sag for _, _, sag in self._sags))
        found = np.zeros((n, stations, 3, self.count), np.result_type(*kinds))
        for k in range(stations):
            found[:, k, :, 6 * k : 6 * k + 3] = _rotations(own[:, k])
            found[:, k, :, 6 * k + 3 : 6 * k + 6] = np.eye(3)
        for k, columns, sag in self._sags:
            found[:, k + 1, 2, columns] = sag[:, 0]
        return found.reshape(n, 3 * stations, self.count)

    @cached_property
    def lengths(self) -> Array:
        """Change of each segment's length, shape (n, s + 1, q)."""
        n = len(self.points)
        moves = np.diff(self.points.reshape(n, -1, 3, self.count), axis=1)
        return np.asarray((self.paths.directions[:, :, None] @ moves)[:, :, 0])

    @cached_property
    def mixed_derivatives(self) -> Array:
        """Mixed second derivatives of the path by x, y on a surface and by a motion, shape (n, 2 s, q)."""
        paths, tangents = self.paths, self.paths.tangents
        gradients = paths.hessian @ self.points
        for k in range(len(paths.shapes)):
            # The gradient at a surface is the optical direction before it less the one behind it.
            gradients[:, 3 * k + 3 : 3 * k + 6, self._indices.start + k] += paths.directions[:, k]
            gradients[:, 3 * k + 3 : 3 * k + 6, self._indices.start + k + 1] -= paths.directions[:, k + 1]
        found = paths.along_surfaces(gradients)
        for k in range(len(paths.shapes)):
            gradient = paths.gradient[:, k + 1]
            for c in range(2):
                turned = np.cross(tangents[:, k, :, c], gradient)
                found[:, 2 * k + c, 6 * k + 6 : 6 * k + 9] += turned
        for k, columns, sag in self._sags:
            found[:, 2 * k : 2 * k + 2, columns] += paths.gradient[:, k + 1, 2, None, None] * sag[:, 1:]
        return found

    @cached_property
    def second(self) -> Array:
        """Second derivatives of the path for fixed object and sensor points, shape (n, q, q).

        The ray slides along the surfaces to where its path is stationary. With the path V of motions i and j
        and of the ray's positions w on the surfaces, the result is V_ij - V_iw V_ww^-1 V_wj.
        """
        paths, points, mixed_derivatives = self.paths, self.points, self.mixed_derivatives
        found = np.swapaxes(points, 1, 2) @ (paths.hessian @ points)
        found -= np.swapaxes(mixed_derivatives, 1, 2) @ np.linalg.solve(
            paths.surface_hessian, mixed_derivatives
        )
        crossed = np.zeros_like(found)
        crossed[:, self._indices] += self.lengths
        ratio = self._indices.stop
        crossed[:, ratio] = (paths.gradient.reshape(len(points), 1, -1) @ points)[:, 0]
        crossed[:, ratio, self._indices] = paths.lengths
        for k, columns, sag in self._sags:
            gradient = paths.gradient[:, k + 1]
            # A rotated surface also rotates the direction of its sag.
            turned = np.cross(np.array([0.0, 0.0, 1.0]), gradient)
            crossed[:, 6 * k + 6 : 6 * k + 9, columns] += turned[:, :, None] * sag[:, :1]
        found += crossed + np.swapaxes(crossed, 1, 2)
        for k, shape in enumerate(paths.shapes):
            own = self._position(paths.layout.of_shape(k))
            hessians = _sag_hessians(shape, paths.heights_mm[:, k])
            found[:, own, own] += paths.gradient[:, k + 1, 2, None, None] * hessians
        return found


def motions_of(changes: Changes) -> Array:
    """Return the motions of which each of d changes consists, shape (q, d)."""
    layout, first = changes.layout, changes.first
    # Positions among the 12 parameters of a pose: matrix elements that are rotations about x, y and z to
    # first order, and then the shift.
    of_pose = (7, 2, 3, 9, 10, 11)
    poses = POSE * np.arange(layout.surfaces + 2)[:, None] + np.array(of_pose)
    rest = np.arange(POSE * (layout.surfaces + 2), layout.size)
    units = np.eye(changes.count)
    rows = [units[columns] for _, columns, _ in changes.figures]
    return np.concatenate([first[poses.ravel()], first[rest], *rows])


def pair_weights(changes: Changes) -> sparse.csr_array:
    """Return the matrix of the chain rule, which yields second derivatives by pairs of changes.

    It multiplies one vector: the second derivatives by motions, followed by the first derivatives by the
    parameters of the system. Its shape is (d (d + 1) / 2, q^2 + parameters); rows are pairs of changes (i,
    j), i <= j, in the order of `numpy.triu_indices`.
    """
    moved = sparse.csr_array(motions_of(changes).T)
    i, j = np.triu_indices(changes.count)
    products = sparse.kron(moved, moved, format="csr")[i * changes.count + j]
    return sparse.hstack([products, changes.second], format="csr")


def second_by_pairs(paths: Paths, weights: sparse.csr_array, sag_errors: Sequence[SagErrors] = ()) -> Array:
    """Return second derivatives of paths in mm by d changes for fixed object and sensor points.

    Parameters
    ----------
    paths
        Nominal paths.
    weights
        Result of :func:`pair_weights` for the changes.
    sag_errors
        Sag errors that the changes cause.

    Returns
    -------
    ndarray, shape (n, d (d + 1) / 2)
    """
    by_motions = Motions(paths, sag_errors).second
    own = np.concatenate([by_motions.reshape(len(by_motions), -1), paths.by_parameters], axis=1)
    return np.asarray((weights @ own.T).T)


def _rotations(points: Array) -> Array:
    """Return derivatives of points by rotations about x, y and z, shape (n, 3, 3)."""
    return np.swapaxes(np.cross(np.eye(3), points[:, None]), 1, 2)


def _sag_hessians(shape: Shape, heights_mm: Array) -> Array:
    """Return second derivatives of a sag by the terms of its shape, shape (n, terms, terms).

    They are computed by a complex step, accurate to rounding errors; the points must be real.
    """
    names = shape.TERMS[: shape.terms.shape[-1]]
    x, y = heights_mm[:, 0], heights_mm[:, 1]
    step = 1e-30
    columns = [
        np.stack([shape.moved(b, step * 1j).derivatives_by(a, x, y)[0].imag / step for a in names], axis=1)
        for b in names
    ]
    return np.stack(columns, axis=2)

"""A plane-parallel plate in air, as a function of the direction of a ray.

A plate changes no direction. It shifts a ray sideways and changes its optical path, and both depend on the
direction alone, not on the position of the plate. They follow from the phase path of a plane wave with
direction cosines (u, v), which the plate changes by

    W(u, v) = t (sqrt(n^2 - u^2 - v^2) - sqrt(1 - u^2 - v^2)).

The shift of the ray on a plane behind the plate is the negative gradient of W, and the change of its optical
path up to that plane is W minus the scalar product of (u, v) with the gradient. Both are exact for skew rays.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.lens.lens import Lens


@dataclass(frozen=True, eq=False)
class PlanePlate:
    """A plane-parallel plate, perpendicular to the z axis, in air.

    Attributes
    ----------
    thickness_mm
        Thickness of the plate.
    index : ndarray, shape (trials or 1,)
        Refractive index in each trial.

    Examples
    --------
    The focus of a paraxial beam moves by t (1 - 1/n):

    >>> import numpy as np
    >>> from lensdesign.raytrace import PlanePlate
    >>> plate = PlanePlate(0.7, np.array([1.5]))
    >>> shift_mm = plate.lateral_shift_mm(np.array([0.001, 0.0]))[0]
    >>> round(float(-shift_mm / 0.001), 4), round(0.7 * (1 - 1 / 1.5), 4)
    (0.2333, 0.2333)
    """

    thickness_mm: float
    index: Array

    def lateral_shift_mm(self, cosines: Array) -> Array:
        """Return by how much the plate shifts rays on any plane behind it.

        Parameters
        ----------
        cosines : ndarray, shape (..., 2), or (trials, rays, 2) if the indices of trials differ
            Direction cosines along x and y.

        Returns
        -------
        ndarray
            Shifts along x and y in mm, of the same shape.
        """
        glass, air = self._along(cosines)
        return np.asarray(self.thickness_mm * cosines * (1.0 / glass - 1.0 / air))

    def shift_by_cosines(self, cosines: Array) -> Array:
        """Return the derivatives of :meth:`lateral_shift_mm` by the cosines, shape (..., 2, 2)."""
        glass, air = self._along(cosines)
        diagonal = (1.0 / glass - 1.0 / air)[..., None] * np.eye(2)
        products = cosines[..., :, None] * cosines[..., None, :]
        return np.asarray(self.thickness_mm * (diagonal + (glass**-3 - air**-3)[..., None] * products))

    def added_path_mm(self, cosines: Array) -> Array:
        """Return the change of the optical path of rays up to a plane behind the plate, shape (...)."""
        glass, air = (part[..., 0] for part in self._along(cosines))
        index = self._index(cosines)[..., 0]
        return np.asarray(self.thickness_mm * (index**2 / glass - 1.0 / air))

    def _index(self, cosines: Array) -> Array:
        """Return the index of each ray, with an additional last axis of length 1."""
        if len(self.index) == 1:
            return np.asarray(self.index)
        return self.index.reshape(-1, *(1,) * (cosines.ndim - 1))

    def _along(self, cosines: Array) -> tuple[Array, Array]:
        """Return the optical direction cosines along z in glass and in air, shape (..., 1)."""
        square = np.sum(cosines**2, axis=-1, keepdims=True)
        # A ray at a right angle to the axis has not arrived; its values are not used.
        return np.sqrt(self._index(cosines) ** 2 - square), np.sqrt(np.maximum(1.0 - square, 1e-300))


def cover_plate(lens: Lens, wavelength_um: float) -> PlanePlate | None:
    """Return the cover glass of a lens's sensor as a plate at a wavelength; None without one."""
    glass = lens.sensor.cover_glass
    if glass is None:
        return None
    return PlanePlate(glass.thickness_mm, np.array([lens.cover_glass_index(wavelength_um)]))

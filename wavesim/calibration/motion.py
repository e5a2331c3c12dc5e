"""Derivatives of fields with respect to a rigid motion of the lens."""

from __future__ import annotations

import math

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from lensdesign.lens.poses import rotation_matrix
from wavesim.calibration.parameters import Decenter, LensPose
from wavesim.fields.field import Field
from wavesim.fields.plane_waves import PlaneWaves
from wavesim.scene.system_state import SystemState

ComplexArray = NDArray[np.complexfloating]


def motion(field: Field, mounting: SystemState, parameter: LensPose) -> ComplexArray:
    """Return the change of a field per unit of a rigid parameter if its sources moved with the lens.

    The generator of the motion is -d/dx for a shift along x, and -(w x (r - c)) . grad for a rotation w
    about a point c. The derivative along z follows from propagation in free space.

    Parameters
    ----------
    field
        Field on a plane.
    mounting
        Mounting of the lens.
    parameter
        Decenter (per mm) or tilt (per deg).

    Returns
    -------
    ndarray
        Change of the field, of its shape.
    """
    along_x, along_y, along_z = gradient(field)
    if isinstance(parameter, Decenter):
        return -along_x if parameter.name == "decenter_x_mm" else -along_y
    grid, pose = field.grid, mounting.pose
    tilt = np.deg2rad(np.atleast_1d(pose.tilt_x_deg))
    axis = (
        np.array([1.0, 0.0, 0.0])
        if parameter.name == "tilt_x_deg"
        else rotation_matrix(tilt, np.zeros(1))[0] @ np.array([0.0, 1.0, 0.0])
    )
    x = grid.x_mm[None, :] - pose.decenter_x_mm
    y = grid.y_mm[:, None] - pose.decenter_y_mm
    z = grid.z_mm - pose.pivot_z_mm
    moved_x, moved_y, moved_z = (
        axis[1] * z - axis[2] * y,
        axis[2] * x - axis[0] * z,
        axis[0] * y - axis[1] * x,
    )
    change = moved_x * along_x + moved_y * along_y + moved_z * along_z
    return np.asarray(-math.radians(1.0) * change)


def gradient(field: Field) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
    """Return the derivatives of a field along x, y and z (for waves towards +z), per mm."""
    spectrum = scipy.fft.fft2(np.asarray(field.values), workers=-1)
    waves = PlaneWaves.of(field.grid, field.wavelength_um, field.index)
    ky, kx = waves.transverse
    return tuple(  # type: ignore[return-value]
        scipy.fft.ifft2(spectrum * (1j * k).astype(spectrum.dtype), workers=-1, overwrite_x=True)
        for k in (kx, ky, waves.kz)
    )

"""Deviations of a lens and of its surfaces from the design: pose, shape, thickness and index."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from lensdesign.errors import InputError

if TYPE_CHECKING:
    from lensdesign.lens.surface_figure import SurfaceFigure

Value = float | NDArray[np.float64]


@dataclass(frozen=True)
class Pose:
    """Pose of a lens: a shift, and a right-handed rotation about a pivot that moves with the shift.

    Each value is a deviation from nominal. Any value may be an array of shape (trials,); all arrays of a pose
    have the same length. A trace with such a pose returns arrays with a leading trial axis.

    Parameters
    ----------
    decenter_x_mm, decenter_y_mm
        Shift perpendicular to the axis.
    despace_mm
        Shift along the axis, positive towards the sensor.
    tilt_x_deg, tilt_y_deg
        Right-handed rotation about the x axis, then about the y axis that has rotated with it.
    pivot_z_mm
        Position of the centre of rotation on the axis, from the front vertex of the lens (or, for one
        surface, from the vertex of that surface).

    Raises
    ------
    InputError
        If a value is not finite or not a number or 1-D array, or if arrays differ in length.

    Examples
    --------
    >>> from lensdesign import Pose
    >>> rotation, shift_mm = Pose(decenter_x_mm=0.1).transform()
    >>> rotation.shape, shift_mm[0].tolist()
    ((1, 3, 3), [0.1, 0.0, 0.0])
    """

    decenter_x_mm: Value = 0.0
    decenter_y_mm: Value = 0.0
    despace_mm: Value = 0.0
    tilt_x_deg: Value = 0.0
    tilt_y_deg: Value = 0.0
    pivot_z_mm: Value = 0.0

    def __post_init__(self) -> None:
        check_values(self)

    def transform(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the rotation and shift from the frame of the moved part to the fixed frame.

        Returns
        -------
        rotation : ndarray, shape (trials or 1, 3, 3)
        shift : ndarray, shape (trials or 1, 3)
            ``fixed = rotation @ own + shift``.
        """
        count = trial_count(self)
        values = np.empty((len(fields(self)), 1 if count is None else count))
        for k, f in enumerate(fields(self)):
            values[k] = getattr(self, f.name)
        rotation, pivot = rotation_matrix(*np.deg2rad(values[3:5])), values[5]
        shift = np.array(values[:3].T)
        shift[:, 2] += pivot
        return rotation, shift - rotation[:, :, 2] * pivot[:, None]


@dataclass(frozen=True)
class SurfacePerturbation:
    """Deviations of one surface from nominal; each is a number or an array of shape (trials,).

    Parameters
    ----------
    decenter_x_mm, decenter_y_mm, despace_mm, tilt_x_deg, tilt_y_deg
        Rigid motion of this surface alone, about its own vertex; see :class:`Pose`.
    radius_mm, conic
        Changes of the radius of curvature and the conic constant.
    thickness_mm
        Change of the distance to the next surface; it moves every surface behind this one.
    index
        Change of the refractive index of the medium behind the surface.
    coating_thickness_percent
        Relative change of the thicknesses of all films of the coating; it does not change the rays. The
        coating must have films.
    shape
        Changes of further parameters of the shape, by their names, such as ``radius_x_mm``.
    figure
        Sag error that is added to the surface's own: one figure, or one for each trial.
    roughness_rms_nm
        Change of the root mean square roughness, which scatters light and does not bend rays.

    Raises
    ------
    InputError
        If a value is not finite or not a number or 1-D array, or if arrays differ in length.

    Examples
    --------
    >>> from lensdesign import SurfacePerturbation
    >>> perturbation = SurfacePerturbation(radius_mm=0.01, tilt_x_deg=0.02)
    >>> perturbation.shape_deltas(), perturbation.pose().tilt_x_deg
    ({'radius_mm': 0.01}, 0.02)
    """

    decenter_x_mm: Value = 0.0
    decenter_y_mm: Value = 0.0
    despace_mm: Value = 0.0
    tilt_x_deg: Value = 0.0
    tilt_y_deg: Value = 0.0
    radius_mm: Value = 0.0
    conic: Value = 0.0
    thickness_mm: Value = 0.0
    index: Value = 0.0
    coating_thickness_percent: Value = 0.0
    shape: Mapping[str, Value] = field(default_factory=dict)
    figure: SurfaceFigure | None = None
    roughness_rms_nm: Value = 0.0

    def __post_init__(self) -> None:
        check_values(self)

    def pose(self) -> Pose:
        """Return the rigid motion."""
        return Pose(self.decenter_x_mm, self.decenter_y_mm, self.despace_mm, self.tilt_x_deg, self.tilt_y_deg)

    def shape_deltas(self) -> dict[str, Value]:
        """Return the deviations of the shape that are not 0, by parameter."""
        deltas = {"radius_mm": self.radius_mm, "conic": self.conic} | dict(self.shape)
        return {name: delta for name, delta in deltas.items() if np.any(delta)}


SURFACE_DELTAS = tuple(f.name for f in fields(SurfacePerturbation) if f.name not in ("shape", "figure"))
"""Names of the numeric deviations that every surface has, whatever its shape."""


def rotation_matrix(tilt_x: NDArray[np.float64], tilt_y: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return right-handed rotations about x, then about the rotated y axis, shape (..., 3, 3).

    Parameters
    ----------
    tilt_x, tilt_y
        Angles in radians, of equal shape.

    Examples
    --------
    >>> import numpy as np
    >>> rotation_matrix(np.array(0.0), np.array(0.0)).tolist()
    [[1.0, 0.0, 0.0], [0.0, 1.0, -0.0], [-0.0, 0.0, 1.0]]
    """
    cx, sx, cy, sy = np.cos(tilt_x), np.sin(tilt_x), np.cos(tilt_y), np.sin(tilt_y)
    entries = cy, 0.0, sy, sx * sy, cx, -sx * cy, -cx * sy, sx, cx * cy  # row by row
    found = np.empty((*np.shape(cx), 9), np.result_type(cx, cy))
    for index, entry in enumerate(entries):
        found[..., index] = entry
    return found.reshape(*np.shape(cx), 3, 3)


def trial_count(*perturbations: Pose | SurfacePerturbation) -> int | None:
    """Return the number of trials of poses and perturbations; None if all are single values.

    Raises
    ------
    InputError
        If arrays differ in length.
    """
    lengths = {
        f"{type(one).__name__}.{name}": np.size(value)
        for one in perturbations
        for name, value in _numbers(one).items()
        if not isinstance(value, float) and np.ndim(value) == 1
    }
    for one in perturbations:
        figure = one.figure if isinstance(one, SurfacePerturbation) else None
        if figure is not None and figure.trials is not None:
            lengths["SurfacePerturbation.figure"] = figure.trials
    if len(set(lengths.values())) > 1:
        raise InputError(f"perturbation arrays must have one length, the number of trials; got {lengths}")
    return next(iter(lengths.values()), None)


def check_values(perturbation: Pose | SurfacePerturbation) -> None:
    """Raise InputError unless all values are finite numbers or 1-D arrays of equal length."""
    for name, value in _numbers(perturbation).items():
        if isinstance(value, float) and math.isfinite(value):
            continue
        array = np.asarray(value)
        if array.ndim > 1 or array.dtype.kind not in "fiu" or not np.all(np.isfinite(array)):
            raise InputError(
                f"{type(perturbation).__name__}.{name} = {value!r}: must be a finite number or a 1-D array "
                "of finite numbers"
            )
    trial_count(perturbation)


def _numbers(perturbation: Pose | SurfacePerturbation) -> dict[str, Value]:
    """Return the values that are numbers or arrays, by name."""
    if isinstance(perturbation, Pose):
        return vars(perturbation)
    return {name: getattr(perturbation, name) for name in SURFACE_DELTAS} | {
        f"shape[{name!r}]": value for name, value in perturbation.shape.items()
    }

"""Where a lens, or one of its surfaces, sits: decenter, tilt and despace about a pivot."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from lensdesign.errors import InputError

if TYPE_CHECKING:
    from lensdesign.lens.figure import SurfaceFigure

Value = float | NDArray[np.float64]


@dataclass(frozen=True)
class Pose:
    """A decenter, then a right-handed rotation about a pivot that moves with the decenter.

    Each value is a delta from nominal. Any value may be an array of shape (trials,); all arrays of a
    pose have the same length, and a trace with such a pose returns a leading trial axis.

    Parameters
    ----------
    decenter_x_mm, decenter_y_mm
        Shift across the axis.
    despace_mm
        Shift along the axis, positive towards the sensor.
    tilt_x_deg, tilt_y_deg
        Right-handed rotation about the x axis, then about the y axis that turned with it.
    pivot_z_mm
        Where on the axis the rotation's centre sits, from the front vertex of the lens (or, for one
        surface, from that surface's own vertex).
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
        """Rotation and shift that take a point from the part's own frame to the fixed one.

        Returns
        -------
        rotation : ndarray, shape (trials or 1, 3, 3)
        shift : ndarray, shape (trials or 1, 3)
            ``fixed = rotation @ own + shift``.
        """
        values = [np.atleast_1d(np.asarray(getattr(self, f.name), float)) for f in fields(self)]
        dx, dy, dz, tilt_x, tilt_y, pivot = np.broadcast_arrays(*values)
        rotation = rotation_matrix(np.deg2rad(tilt_x), np.deg2rad(tilt_y))
        centre = np.stack([np.zeros_like(pivot), np.zeros_like(pivot), pivot], axis=-1)
        turned = np.einsum("tij,tj->ti", rotation, centre)
        return rotation, np.stack([dx, dy, dz], axis=-1) + centre - turned


@dataclass(frozen=True)
class SurfacePerturbation:
    """Deltas of one surface from nominal; each a number or an array of shape (trials,).

    The first five move this surface alone about its own vertex. A change of thickness moves every
    surface behind it; the index is that of the medium behind the surface. `shape` has the deltas of what the
    surface's shape has beside radius_mm and conic, by its `PARAMETERS`, such as radius_x_mm. The figure, a
    sag error that adds to the surface's own, holds either one figure or one for each trial.
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
    shape: Mapping[str, Value] = field(default_factory=dict)
    figure: SurfaceFigure | None = None

    def __post_init__(self) -> None:
        check_values(self)

    def pose(self) -> Pose:
        """The rigid part."""
        return Pose(self.decenter_x_mm, self.decenter_y_mm, self.despace_mm, self.tilt_x_deg, self.tilt_y_deg)

    def of_shape(self) -> dict[str, Value]:
        """Deltas of the shape that are not 0, by parameter."""
        deltas = {"radius_mm": self.radius_mm, "conic": self.conic} | dict(self.shape)
        return {name: delta for name, delta in deltas.items() if np.any(delta)}


SURFACE_DELTAS = tuple(f.name for f in fields(SurfacePerturbation) if f.name not in ("shape", "figure"))
"""Deltas of a surface that are numbers and those of every shape."""


def rotation_matrix(tilt_x: NDArray[np.float64], tilt_y: NDArray[np.float64]) -> NDArray[np.float64]:
    """Right-handed rotation about x, then about the turned y axis; angles in radians, shape (..., 3, 3)."""
    cx, sx, cy, sy = np.cos(tilt_x), np.sin(tilt_x), np.cos(tilt_y), np.sin(tilt_y)
    zero = np.zeros_like(cx)
    rows = [[cy, zero, sy], [sx * sy, cx, -sx * cy], [-cx * sy, sx, cx * cy]]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def trial_count(*parts: Pose | SurfacePerturbation) -> int | None:
    """Number of trials that these poses and perturbations hold; None when all are single values.

    Raises
    ------
    InputError
        If arrays of different lengths meet.
    """
    lengths = {
        f"{type(part).__name__}.{name}": np.size(value)
        for part in parts
        for name, value in _numbers(part).items()
        if np.ndim(value) == 1
    }
    for part in parts:
        figure = part.figure if isinstance(part, SurfacePerturbation) else None
        if figure is not None and figure.trials is not None:
            lengths["SurfacePerturbation.figure"] = figure.trials
    if len(set(lengths.values())) > 1:
        raise InputError(f"perturbation arrays must have one length, the number of trials; got {lengths}")
    return next(iter(lengths.values()), None)


def check_values(part: Pose | SurfacePerturbation) -> None:
    """Refuse values that are not finite numbers or one-dimensional arrays of them."""
    for name, value in _numbers(part).items():
        array = np.asarray(value)
        if array.ndim > 1 or array.dtype.kind not in "fiu" or not np.all(np.isfinite(array)):
            raise InputError(
                f"{type(part).__name__}.{name} = {value!r}: must be a finite number or a 1-D array of them"
            )
    trial_count(part)


def _numbers(part: Pose | SurfacePerturbation) -> dict[str, Value]:
    """The values that are numbers or arrays of them, by name."""
    if isinstance(part, Pose):
        return vars(part)
    return {name: getattr(part, name) for name in SURFACE_DELTAS} | {
        f"shape[{name!r}]": value for name, value in part.shape.items()
    }

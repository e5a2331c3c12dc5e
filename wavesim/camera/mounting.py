"""How a lens sits between object and sensor."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydantic import field_validator

from lensdesign.common.input_files import TABLE_BYTES, read_input
from lensdesign.common.section import Finite, Section, tuples
from lensdesign.common.toml_files import did_you_mean, validate
from lensdesign.errors import InputError
from lensdesign.lens.poses import Pose
from wavesim.camera.recorded import Recorded
from wavesim.fields.field import Field
from wavesim.scene.scene import Scene

DECENTERS = ("decenter_x_mm", "decenter_y_mm")
TILTS = ("tilt_x_deg", "tilt_y_deg")
WORKING_DISTANCE = "working_distance_mm"
PLANE_DISTANCE = "plane_distance_{}_mm"


class Mounting(Section):
    """Deltas from the design; object and sensor stand where the design has them unless said otherwise.

    Attributes
    ----------
    decenter_x_mm, decenter_y_mm, tilt_x_deg, tilt_y_deg, pivot_z_mm
        Of the lens, as of :class:`lensdesign.Pose`.
    working_distance_mm
        How much farther from the lens the object is.
    plane_distances_mm
        How much farther from the lens each recorded plane is; planes beyond the list are where they say.
    """

    decenter_x_mm: Finite = 0.0
    decenter_y_mm: Finite = 0.0
    tilt_x_deg: Finite = 0.0
    tilt_y_deg: Finite = 0.0
    pivot_z_mm: Finite = 0.0
    working_distance_mm: Finite = 0.0
    plane_distances_mm: tuple[Finite, ...] = ()

    _lists = field_validator("plane_distances_mm", mode="before")(tuples)

    @property
    def pose(self) -> Pose:
        """Of the lens."""
        return Pose(
            decenter_x_mm=self.decenter_x_mm,
            decenter_y_mm=self.decenter_y_mm,
            tilt_x_deg=self.tilt_x_deg,
            tilt_y_deg=self.tilt_y_deg,
            pivot_z_mm=self.pivot_z_mm,
        )

    def scene(self, nominal: Scene) -> Scene:
        """The scene with the lens and the object where they are."""
        grid = nominal.object_grid
        return replace(nominal, pose=self.pose, object_grid=grid.at(grid.z_mm - self.working_distance_mm))

    def illumination(self, nominal: Field) -> Field:
        """The light on the object where it is; the object takes its light with it."""
        grid = nominal.grid.at(nominal.grid.z_mm - self.working_distance_mm)
        return Field(grid, nominal.values, nominal.wavelength_um, nominal.index)

    def recorded(self, nominal: Sequence[Recorded]) -> list[Recorded]:
        """The planes where they are."""
        deltas = (*self.plane_distances_mm, *[0.0] * len(nominal))
        return [replace(p, distance_mm=p.distance_mm + d) for p, d in zip(nominal, deltas, strict=False)]

    def values_of(self, parameters: Sequence[str]) -> NDArray[np.float64]:
        """Values by the names of :func:`parameter_names`."""
        return np.array([self._value_of(name) for name in parameters])

    def _value_of(self, name: str) -> float:
        plane = plane_of(name)
        if plane is None:
            return float(getattr(self, name))
        return self.plane_distances_mm[plane] if plane < len(self.plane_distances_mm) else 0.0

    def with_values(self, parameters: Sequence[str], values: Sequence[float]) -> Mounting:
        """The same but for values by the names of :func:`parameter_names`."""
        changed = self.model_dump()
        planes = [plane_of(name) for name in parameters]
        distances = list(self.plane_distances_mm)
        distances += [0.0] * (max((p + 1 for p in planes if p is not None), default=0) - len(distances))
        for name, plane, value in zip(parameters, planes, values, strict=True):
            if plane is None:
                changed[name] = float(value)
            else:
                distances[plane] = float(value)
        return Mounting(**changed | {"plane_distances_mm": tuple(distances)})


def read_mounting(path: str | os.PathLike[str]) -> Mounting:
    """The mounting that `wavesim calibrate` has found.

    Raises
    ------
    InputError
        If the file cannot be read, or holds no mounting.
    """
    content = read_input(path, TABLE_BYTES)
    try:
        data = json.loads(content.decode("utf-8"))
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: no JSON: {error}") from None
    mounting = data.get("mounting") if isinstance(data, dict) else None
    if not isinstance(mounting, dict):
        raise InputError(f"{path}: holds no mounting; must be the calibration.json of `wavesim calibrate`")
    return validate(Mounting, mounting, Path(path))


def parameter_names(planes: int) -> tuple[str, ...]:
    """What may be unknown of a mounting with so many recorded planes."""
    return (
        *DECENTERS,
        *TILTS,
        WORKING_DISTANCE,
        *(PLANE_DISTANCE.format(n) for n in range(1, planes + 1)),
    )


def refuse_parameters(parameters: Sequence[str], planes: int) -> None:
    """Refuse names that are none of :func:`parameter_names`, or stand twice.

    Raises
    ------
    InputError
        Naming the parameter.
    """
    allowed = parameter_names(planes)
    for name in parameters:
        if name not in allowed:
            raise InputError(
                f"parameter {name!r}: unknown; allowed: {', '.join(allowed)}{did_you_mean(name, allowed)}"
            )
    if not parameters or len(set(parameters)) < len(parameters):
        raise InputError(f"parameters = {', '.join(parameters) or 'none'}: must be one or more, each once")


def plane_of(name: str) -> int | None:
    """Number, from 0, of the recorded plane whose distance a parameter is; None if it is none."""
    head, tail = PLANE_DISTANCE.split("{}")
    if name.startswith(head) and name.endswith(tail):
        return int(name[len(head) : -len(tail)]) - 1
    return None

"""Mounting of a lens between object and sensor: file format, calibration parameters, effect on the planes."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.frozen_model import Finite, FrozenModel
from lensdesign.common.input_files import TABLE_BYTES, read_input
from lensdesign.common.toml_files import did_you_mean, validate
from lensdesign.errors import InputError
from lensdesign.lens.poses import Pose
from wavesim.fields.field import Field
from wavesim.scene.bench import Bench, bench_of
from wavesim.scene.placement import Placement
from wavesim.scene.scene import placed_object
from wavesim.sensor.measurement import Measurement

DECENTERS = ("decenter_x_mm", "decenter_y_mm")
TILTS = ("tilt_x_deg", "tilt_y_deg")
RIGID = (*DECENTERS, *TILTS)
WORKING_DISTANCE = "working_distance_mm"
PLANE_DISTANCE = "plane_distance_{}_mm"


class _Table(FrozenModel):
    """File format of a mounting; `working_distance_mm` is the true minus the nominal object distance."""

    decenter_x_mm: Finite = 0.0
    decenter_y_mm: Finite = 0.0
    tilt_x_deg: Finite = 0.0
    tilt_y_deg: Finite = 0.0
    pivot_z_mm: Finite = 0.0
    working_distance_mm: Finite = 0.0
    plane_distances_mm: tuple[Finite, ...] = ()


def mounting_table(mounting: Placement) -> dict[str, Any]:
    """Return a mounting as a JSON-ready dict, the inverse of :func:`mounting_of`."""
    table = _Table(
        **{name: getattr(mounting.pose, name) for name in (*DECENTERS, *TILTS, "pivot_z_mm")},
        working_distance_mm=0.0 - mounting.object_shift_mm[2],
        plane_distances_mm=mounting.plane_distances_mm,
    )
    return table.model_dump(mode="json")


def read_table(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Read the file that `wavesim calibrate` writes.

    Raises
    ------
    InputError
        If the file cannot be read, or contains no mounting.
    """
    content = read_input(path, TABLE_BYTES)
    try:
        data = json.loads(content.decode("utf-8"))
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: not a JSON file: {error}") from None
    if not isinstance(data, dict) or not isinstance(data.get("mounting"), dict):
        raise InputError(f"{path}: contains no mounting; must be the calibration.json of `wavesim calibrate`")
    return data


def mounting_of(mounting: dict[str, Any], path: str | os.PathLike[str]) -> Placement:
    """Return the mounting that a dict of :func:`mounting_table` describes.

    Parameters
    ----------
    mounting
        The dict, as read from a file.
    path
        Path of that file, for error messages.

    Raises
    ------
    InputError
        If a value is invalid.
    """
    table = validate(_Table, mounting, Path(path)).model_dump()
    planes, farther = table.pop("plane_distances_mm"), table.pop(WORKING_DISTANCE)
    return Placement(Pose(**table), object_shift_mm=(0.0, 0.0, 0.0 - farther), plane_distances_mm=planes)


def light_on(nominal: Field, bench: Placement | Bench) -> Field:
    """Return the illumination on the displaced object; it moves with the object."""
    bench = bench_of(bench)
    mounting, nominal = bench.placement, bench.light.on(nominal)
    wavelength = mounting.wavelength_um or nominal.wavelength_um
    return Field(placed_object(nominal.grid, mounting), nominal.values, wavelength, nominal.index)


def planes_at(nominal: Sequence[Measurement], bench: Placement | Bench) -> list[Measurement]:
    """Return the recorded planes at their true positions, with their backgrounds."""
    return [_plane_at(plane, bench_of(bench), index) for index, plane in enumerate(nominal)]


def _plane_at(plane: Measurement, bench: Bench, index: int) -> Measurement:
    fraction = bench.background(index)
    background = None
    if fraction:
        mean = np.mean(np.square(plane.amplitude), dtype=float)
        background = np.full_like(plane.amplitude, fraction * mean)
    distance_mm = plane.distance_mm + bench.placement.plane_distance_mm(index)
    return replace(
        plane,
        distance_mm=distance_mm,
        shift_mm=bench.shift_mm(index),
        tilt_deg=bench.placement.sensor_tilt_deg,
        background=background,
    )


def values_of(mounting: Placement, parameters: Sequence[str]) -> NDArray[np.float64]:
    """Return the values of named parameters (:func:`parameter_names`) of a mounting."""

    def value(name: str) -> float:
        plane = plane_of(name)
        if name == WORKING_DISTANCE:
            return 0.0 - mounting.object_shift_mm[2]
        if plane is None:
            return float(getattr(mounting.pose, name))
        return mounting.plane_distance_mm(plane)

    return np.array([value(name) for name in parameters])


def with_values(mounting: Placement, parameters: Sequence[str], values: Sequence[float]) -> Placement:
    """Return the mounting with new values of named parameters (:func:`parameter_names`)."""
    given = dict(zip(parameters, map(float, values), strict=True))
    x, y, z = mounting.object_shift_mm
    planes = {plane_of(name): value for name, value in given.items()}
    count = max((n + 1 for n in planes if n is not None), default=0)
    current = values_of(mounting, [PLANE_DISTANCE.format(n + 1) for n in range(count)]).tolist()
    return replace(
        mounting,
        pose=replace(mounting.pose, **{n: v for n, v in given.items() if n in (*DECENTERS, *TILTS)}),
        object_shift_mm=(x, y, 0.0 - given.get(WORKING_DISTANCE, 0.0 - z)),
        plane_distances_mm=(
            *(planes.get(n, own) for n, own in enumerate(current)),
            *mounting.plane_distances_mm[count:],
        ),
    )


def parameter_names(planes: int) -> tuple[str, ...]:
    """Return the names of the calibration parameters of a mounting with this number of planes."""
    return (
        *DECENTERS,
        *TILTS,
        WORKING_DISTANCE,
        *(PLANE_DISTANCE.format(n) for n in range(1, planes + 1)),
    )


def validate_parameters(parameters: Sequence[str], planes: int) -> None:
    """Check that names of parameters are known and unique.

    Raises
    ------
    InputError
        If a name is not one of :func:`parameter_names`, is given twice, or none is given.
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
    """Return the index of the plane whose distance a parameter is, or None for other parameters."""
    head, tail = PLANE_DISTANCE.split("{}")
    if name.startswith(head) and name.endswith(tail):
        return int(name[len(head) : -len(tail)]) - 1
    return None

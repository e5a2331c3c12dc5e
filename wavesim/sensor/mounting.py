"""How a lens sits between object and sensor."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import field_validator

from lensdesign.common.input_files import TABLE_BYTES, read_input
from lensdesign.common.section import Finite, Section, tuples
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


class _Table(Section):
    """A mounting as files have it; `working_distance_mm` is how much farther from the lens the object is."""

    decenter_x_mm: Finite = 0.0
    decenter_y_mm: Finite = 0.0
    tilt_x_deg: Finite = 0.0
    tilt_y_deg: Finite = 0.0
    pivot_z_mm: Finite = 0.0
    working_distance_mm: Finite = 0.0
    plane_distances_mm: tuple[Finite, ...] = ()

    _lists = field_validator("plane_distances_mm", mode="before")(tuples)


def mounting_table(mounting: Placement) -> dict[str, Any]:
    """A mounting as :func:`mounting_of` takes it, ready for JSON."""
    table = _Table(
        **{name: getattr(mounting.pose, name) for name in (*DECENTERS, *TILTS, "pivot_z_mm")},
        working_distance_mm=0.0 - mounting.object_shift_mm[2],
        plane_distances_mm=mounting.plane_distances_mm,
    )
    return table.model_dump(mode="json")


def read_table(path: str | os.PathLike[str]) -> dict[str, Any]:
    """The file that `wavesim calibrate` writes.

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
    if not isinstance(data, dict) or not isinstance(data.get("mounting"), dict):
        raise InputError(f"{path}: holds no mounting; must be the calibration.json of `wavesim calibrate`")
    return data


def mounting_of(mounting: dict[str, Any], path: str | os.PathLike[str]) -> Placement:
    """What :func:`mounting_table` made a table of, which stands in a file.

    Raises
    ------
    InputError
        If a value is not usable.
    """
    table = validate(_Table, mounting, Path(path)).model_dump()
    planes, farther = table.pop("plane_distances_mm"), table.pop(WORKING_DISTANCE)
    return Placement(Pose(**table), object_shift_mm=(0.0, 0.0, 0.0 - farther), plane_distances_mm=planes)


def light_on(nominal: Field, bench: Placement | Bench) -> Field:
    """The light on the object where it is; the object takes its light with it."""
    bench = bench_of(bench)
    mounting, nominal = bench.placement, bench.light.on(nominal)
    wavelength = mounting.wavelength_um or nominal.wavelength_um
    return Field(placed_object(nominal.grid, mounting), nominal.values, wavelength, nominal.index)


def planes_at(nominal: Sequence[Measurement], bench: Placement | Bench) -> list[Measurement]:
    """The recorded planes where they are, with what is on them beside the object's light."""
    return [_plane_at(plane, bench_of(bench), number) for number, plane in enumerate(nominal)]


def _plane_at(plane: Measurement, bench: Bench, number: int) -> Measurement:
    share = bench.background(number)
    behind = None
    if share:
        mean = np.mean(np.square(plane.amplitude), dtype=float)
        behind = np.full_like(plane.amplitude, share * mean)
    distance_mm = plane.distance_mm + bench.placement.plane_distance_mm(number)
    return replace(
        plane,
        distance_mm=distance_mm,
        shift_mm=bench.shift_mm(number),
        tilt_deg=bench.placement.sensor_tilt_deg,
        background=behind,
    )


def values_of(mounting: Placement, parameters: Sequence[str]) -> NDArray[np.float64]:
    """Values by the names of :func:`parameter_names`."""

    def value(name: str) -> float:
        plane = plane_of(name)
        if name == WORKING_DISTANCE:
            return 0.0 - mounting.object_shift_mm[2]
        if plane is None:
            return float(getattr(mounting.pose, name))
        return mounting.plane_distance_mm(plane)

    return np.array([value(name) for name in parameters])


def with_values(mounting: Placement, parameters: Sequence[str], values: Sequence[float]) -> Placement:
    """The same but for values by the names of :func:`parameter_names`."""
    given = dict(zip(parameters, map(float, values), strict=True))
    x, y, z = mounting.object_shift_mm
    planes = {plane_of(name): value for name, value in given.items()}
    count = max((n + 1 for n in planes if n is not None), default=0)
    before = values_of(mounting, [PLANE_DISTANCE.format(n + 1) for n in range(count)]).tolist()
    return replace(
        mounting,
        pose=replace(mounting.pose, **{n: v for n, v in given.items() if n in (*DECENTERS, *TILTS)}),
        object_shift_mm=(x, y, 0.0 - given.get(WORKING_DISTANCE, 0.0 - z)),
        plane_distances_mm=(
            *(planes.get(n, own) for n, own in enumerate(before)),
            *mounting.plane_distances_mm[count:],
        ),
    )


def parameter_names(planes: int) -> tuple[str, ...]:
    """What may be unknown of a mounting with so many recorded planes."""
    return (
        *DECENTERS,
        *TILTS,
        WORKING_DISTANCE,
        *(PLANE_DISTANCE.format(n) for n in range(1, planes + 1)),
    )


def validate_parameters(parameters: Sequence[str], planes: int) -> None:
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

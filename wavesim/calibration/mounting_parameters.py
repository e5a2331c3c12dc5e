"""Parameters of a mounting that a calibration seeks: pose of the lens, and distances of object and planes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.toml_files import did_you_mean
from lensdesign.errors import InputError
from wavesim.scene.system_state import SystemState

DECENTERS = ("decenter_x_mm", "decenter_y_mm")
TILTS = ("tilt_x_deg", "tilt_y_deg")
RIGID = (*DECENTERS, *TILTS)
WORKING_DISTANCE = "working_distance_mm"
"""Distance of the object from the lens: the true minus the nominal one."""

PLANE_DISTANCE = "plane_distance_{}_mm"

STOP_SHIFTS = ("field_stop_shift_x_mm", "field_stop_shift_y_mm")
"""Shift of the field stop, together with the object, from a first position that was found from the frames."""


def values_of(state: SystemState, parameters: Sequence[str]) -> NDArray[np.float64]:
    """Return the values of named parameters (:func:`parameter_names`) of a state."""

    def value(name: str) -> float:
        plane = plane_of(name)
        if name == WORKING_DISTANCE:
            return 0.0 - state.object_shift_mm[2]
        if name in STOP_SHIFTS:
            return state.object_shift_mm[STOP_SHIFTS.index(name)]
        if plane is None:
            return float(getattr(state.pose, name))
        return state.sensor_pose(plane).distance_mm

    return np.array([value(name) for name in parameters])


def with_values(state: SystemState, parameters: Sequence[str], values: Sequence[float]) -> SystemState:
    """Return the state with new values of named parameters (:func:`parameter_names`)."""
    given = dict(zip(parameters, map(float, values), strict=True))
    x, y, z = state.object_shift_mm
    x, y = (given.get(name, own) for name, own in zip(STOP_SHIFTS, (x, y), strict=True))
    planes = {plane_of(name): value for name, value in given.items()}
    count = max((n + 1 for n in planes if n is not None), default=0)
    current = values_of(state, [PLANE_DISTANCE.format(n + 1) for n in range(count)]).tolist()
    return replace(
        state,
        pose=replace(state.pose, **{n: v for n, v in given.items() if n in (*DECENTERS, *TILTS)}),
        object_shift_mm=(x, y, 0.0 - given.get(WORKING_DISTANCE, 0.0 - z)),
        plane_distance_errors_mm=(
            *(planes.get(n, own) - state.sensor_shift_mm[2] for n, own in enumerate(current)),
            *state.plane_distance_errors_mm[count:],
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

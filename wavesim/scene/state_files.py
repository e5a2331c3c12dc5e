"""JSON form of a system state, which commands and calibrations write and read.

Only deviations from the design are written: the state of a system as designed is an empty table. Surfaces
are counted from 1. The modes of the light are named by their orders in x and y, such as "20".
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import MISSING, fields
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field, field_validator

from lensdesign.common.atomic_files import atomic_path
from lensdesign.common.frozen_model import Finite, FrozenModel, Positive
from lensdesign.common.input_files import read_json
from lensdesign.common.toml_files import validate
from lensdesign.errors import InputError
from lensdesign.lens.lens import Lens
from lensdesign.lens.poses import Pose, SurfacePerturbation
from lensdesign.lens.surface_figure import SurfaceFigure
from wavesim.scene.light_errors import LightErrors, Orders
from wavesim.scene.source import Source
from wavesim.scene.system_state import SystemState

STATE = "state"
"""Key of the state in files."""

Pair = tuple[Finite, Finite]
Triple = tuple[Finite, Finite, Finite]
Numbers = tuple[Finite, ...]
Modes = dict[Annotated[str, Field(pattern=r"^\d\d$")], Finite]


class _Pose(FrozenModel):
    decenter_x_mm: Finite = 0.0
    decenter_y_mm: Finite = 0.0
    despace_mm: Finite = 0.0
    tilt_x_deg: Finite = 0.0
    tilt_y_deg: Finite = 0.0
    pivot_z_mm: Finite = 0.0


class _Figure(FrozenModel):
    semi_diameter_mm: Positive
    spacing_mm: Positive
    coefficients_mm: tuple[tuple[Finite, ...], ...]

    @field_validator("coefficients_mm")
    @classmethod
    def _rectangular(cls, coefficients: tuple[tuple[float, ...], ...]) -> tuple[tuple[float, ...], ...]:
        # A spline has two coefficients more than cells of the grid, of which there is at least one.
        if len(coefficients) < 4 or len({len(row) for row in coefficients}) > 1 or len(coefficients[0]) < 4:
            raise ValueError("must be a rectangle of at least 4 by 4 numbers")
        return coefficients


class _Surface(FrozenModel):
    decenter_x_mm: Finite = 0.0
    decenter_y_mm: Finite = 0.0
    despace_mm: Finite = 0.0
    tilt_x_deg: Finite = 0.0
    tilt_y_deg: Finite = 0.0
    radius_mm: Finite = 0.0
    conic: Finite = 0.0
    thickness_mm: Finite = 0.0
    index: Finite = 0.0
    coating_thickness_percent: Finite = 0.0
    shape: dict[str, Finite] = Field(default_factory=dict)
    figure: _Figure | None = None
    roughness_rms_nm: Finite = 0.0


class _Light(FrozenModel):
    tilt_deg: Pair = (0.0, 0.0)
    amplitude: Modes = Field(default_factory=dict)
    phase_waves: Modes = Field(default_factory=dict)


class _Source(FrozenModel):
    width_deg: Finite = 0.0
    bandwidth_nm: Finite = 0.0


class _State(FrozenModel):
    pose: _Pose = _Pose()
    surfaces: dict[Annotated[str, Field(pattern=r"^[1-9]\d*$")], _Surface] = Field(default_factory=dict)
    object_shift_mm: Triple = (0.0, 0.0, 0.0)
    sensor_shift_mm: Triple = (0.0, 0.0, 0.0)
    plane_distance_errors_mm: Numbers = ()
    # In files of earlier versions, which lack this key, these errors replace the z component of the shift.
    plane_distance_errors_add: bool = False
    sensor_tilt_deg: Pair = (0.0, 0.0)
    wavelength_um: Positive | None = None
    light: _Light = _Light()
    plane_shifts_um: tuple[Pair, ...] = ()
    plane_backgrounds: Numbers = ()
    plane_background_slopes: tuple[Pair, ...] = ()
    plane_exposure_errors: Numbers = ()
    nonlinearity: Finite = 0.0
    vibration_um: Finite = 0.0
    source: _Source = _Source()


def state_table(state: SystemState) -> dict[str, Any]:
    """Return a state as a dict for JSON, the inverse of :func:`state_from_table`.

    Raises
    ------
    InputError
        If the state contains arrays of trials instead of numbers.
    """
    table = _deviations(state)
    if state.plane_distance_errors_mm and state.sensor_shift_mm[2]:
        table["plane_distance_errors_add"] = True
    surfaces = table.pop("surface_perturbations", {})
    if surfaces:
        table["surfaces"] = {str(index + 1): surfaces[index] for index in sorted(surfaces)}
    return table


def _deviations(value: Any) -> dict[str, Any]:
    """Return the fields of a dataclass that differ from their defaults, ready for JSON."""
    table = {}
    for one in fields(value):
        own = getattr(value, one.name)
        default = one.default_factory() if one.default_factory is not MISSING else one.default
        if own is not None and (plain := _plain(own, one.name)) != _plain(default, one.name):
            table[one.name] = plain
    return table


def _plain(value: Any, name: str) -> Any:
    if isinstance(value, Pose | SurfacePerturbation | LightErrors | Source):
        return _deviations(value)
    if isinstance(value, SurfaceFigure):
        if value.trials is not None:
            raise InputError(f"state: {name}: holds the figures of several trials; a state describes one")
        return {
            "semi_diameter_mm": value.semi_diameter_mm,
            "spacing_mm": value.spacing_mm,
            "coefficients_mm": value.coefficients.tolist(),
        }
    if isinstance(value, Mapping):
        return {
            "".join(map(str, key)) if isinstance(key, tuple) else key: _plain(one, name)
            for key, one in value.items()
        }
    if isinstance(value, tuple):
        return [_plain(one, name) for one in value]
    if value is None:
        return None
    if np.ndim(value):
        raise InputError(f"state: {name} has the values of several trials; a state describes one")
    return float(value)


def state_from_table(table: Mapping[str, Any], path: str | os.PathLike[str], lens: Lens) -> SystemState:
    """Return the state that a dict of :func:`state_table` describes.

    Parameters
    ----------
    table
        The dict, as read from a file.
    path
        Path of that file, for messages.
    lens
        The design whose deviations these are.

    Raises
    ------
    InputError
        If a key is unknown, a value is not allowed, or the lens has no such surface.
    """
    read = validate(_State, dict(table), Path(path))
    count = len(lens.surfaces)
    for number in read.surfaces:
        if int(number) > count:
            raise InputError(
                f"{path}: {STATE}: surfaces: {number}: the lens has {count} surfaces; give the design to "
                "which the state belongs"
            )
    errors_mm = read.plane_distance_errors_mm
    if not read.plane_distance_errors_add:
        errors_mm = tuple(error - read.sensor_shift_mm[2] for error in errors_mm)
    try:
        return SystemState(
            pose=Pose(**read.pose.model_dump()),
            surface_perturbations={int(n) - 1: _surface(one) for n, one in read.surfaces.items()},
            object_shift_mm=read.object_shift_mm,
            sensor_shift_mm=read.sensor_shift_mm,
            plane_distance_errors_mm=errors_mm,
            sensor_tilt_deg=read.sensor_tilt_deg,
            wavelength_um=read.wavelength_um,
            light=LightErrors(
                read.light.tilt_deg, _by_orders(read.light.amplitude), _by_orders(read.light.phase_waves)
            ),
            plane_shifts_um=read.plane_shifts_um,
            plane_backgrounds=read.plane_backgrounds,
            plane_background_slopes=read.plane_background_slopes,
            plane_exposure_errors=read.plane_exposure_errors,
            nonlinearity=read.nonlinearity,
            vibration_um=read.vibration_um,
            source=Source(**read.source.model_dump()),
        )
    except InputError as error:
        raise InputError(f"{path}: {STATE}: {error}") from None


def _surface(read: _Surface) -> SurfacePerturbation:
    values = read.model_dump(exclude={"figure"})
    if read.figure is None:
        return SurfacePerturbation(**values)
    coefficients = np.array(read.figure.coefficients_mm)
    return SurfacePerturbation(
        **values, figure=SurfaceFigure(read.figure.semi_diameter_mm, read.figure.spacing_mm, coefficients)
    )


def _by_orders(modes: Mapping[str, float]) -> dict[Orders, float]:
    return {(int(name[0]), int(name[1])): value for name, value in modes.items()}


def write_state(state: SystemState, path: str | os.PathLike[str]) -> Path:
    """Write a state to a JSON file, and return its path.

    Raises
    ------
    InputError
        If the file cannot be written, or the state contains arrays of trials.

    Examples
    --------
    >>> from lensdesign import Pose, load_design
    >>> from wavesim import SystemState, read_state, write_state
    >>> path = write_state(SystemState(Pose(decenter_x_mm=0.01)), "state.json")
    >>> read_state(path, load_design("designs/paper_singlet.toml")).pose.decenter_x_mm
    0.01
    """
    text = json.dumps({STATE: state_table(state)}, indent=2) + "\n"
    with atomic_path(Path(path)) as new:
        new.write_text(text, encoding="utf-8")
    return Path(path)


def read_state(path: str | os.PathLike[str], lens: Lens) -> SystemState:
    """Return the state of a file that :func:`write_state` or `wavesim calibrate` has written.

    Parameters
    ----------
    path
        JSON file with the key "state".
    lens
        The design whose deviations these are.

    Raises
    ------
    InputError
        If the file cannot be read, contains no state, or belongs to another lens.

    Examples
    --------
    >>> from lensdesign import load_design
    >>> from wavesim import SystemState, read_state, write_state
    >>> path = write_state(SystemState(sensor_tilt_deg=(0.2, 0.0)), "state.json")
    >>> read_state(path, load_design("designs/paper_singlet.toml")).sensor_tilt_deg
    (0.2, 0.0)
    """
    return state_of_file(read_json(path), path, lens)


def state_of_file(data: Mapping[str, Any], path: str | os.PathLike[str], lens: Lens) -> SystemState:
    """Return the state in the content of a JSON file; parameters and errors as in :func:`read_state`."""
    table = data.get(STATE)
    if not isinstance(table, dict):
        raise InputError(
            f"{path}: contains no state; must be the calibration.json of `wavesim calibrate`, or a file with "
            f'the key "{STATE}"'
        )
    return state_from_table(table, path, lens)

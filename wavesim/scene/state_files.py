"""JSON form of a system state, which commands and calibrations write and read.

Only deviations from the design are written: the state of a system as designed is an empty table. Surfaces
are counted from 1. The modes of the light are named by their orders in x and y, such as "20".
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import MISSING, fields, is_dataclass
from pathlib import Path
from typing import Annotated, Any, get_type_hints

import numpy as np
from pydantic import AfterValidator, ConfigDict, Field, create_model, field_validator

from lensdesign.common.atomic_files import atomic_path
from lensdesign.common.frozen_model import FrozenModel, Positive
from lensdesign.common.input_files import read_json
from lensdesign.common.toml_files import validate
from lensdesign.errors import InputError
from lensdesign.lens.lens import Lens
from lensdesign.lens.poses import SurfacePerturbation, Value
from lensdesign.lens.surface_figure import SurfaceFigure
from wavesim.scene.light_errors import Orders
from wavesim.scene.system_state import SystemState

STATE = "state"
"""Key of the state in files."""


class _Table(FrozenModel):
    """Table of a file, whose numbers are finite."""

    model_config = ConfigDict(allow_inf_nan=False)


class _Figure(_Table):
    semi_diameter_mm: Positive
    spacing_mm: Positive
    coefficients_mm: tuple[tuple[float, ...], ...]

    @field_validator("coefficients_mm")
    @classmethod
    def _rectangular(cls, coefficients: tuple[tuple[float, ...], ...]) -> tuple[tuple[float, ...], ...]:
        # A spline has two coefficients more than cells of the grid, of which there is at least one.
        if len(coefficients) < 4 or len({len(row) for row in coefficients}) > 1 or len(coefficients[0]) < 4:
            raise ValueError("must be a rectangle of at least 4 by 4 numbers")
        return coefficients

    def figure(self) -> SurfaceFigure:
        return SurfaceFigure(self.semi_diameter_mm, self.spacing_mm, np.array(self.coefficients_mm))


def _by_orders(modes: Mapping[str, float]) -> dict[Orders, float]:
    return {(int(name[0]), int(name[1])): value for name, value in modes.items()}


def _by_index(surfaces: Mapping[str, SurfacePerturbation]) -> dict[int, SurfacePerturbation]:
    return {int(number) - 1: surface for number, surface in surfaces.items()}


FORMS: dict[Any, Any] = {
    Value: float,
    float | None: Positive | None,
    Mapping[str, Value]: Mapping[str, float],
    Mapping[Orders, float]: Annotated[
        dict[Annotated[str, Field(pattern=r"^\d\d$")], float], AfterValidator(_by_orders)
    ],
    SurfaceFigure | None: Annotated[_Figure, AfterValidator(_Figure.figure)] | None,
}
"""Types of fields as they are read from a file, where these differ from those of the dataclass."""

KEYS = {"surface_perturbations": "surfaces"}
"""Keys of fields, where these differ from their names."""


def _table_of(kind: type, **further: Any) -> type[_Table]:
    """Return the table whose keys are the fields of a dataclass; each of them may be omitted."""
    hints = get_type_hints(kind, None, {"SurfaceFigure": SurfaceFigure})
    keys: dict[str, Any] = {}
    for one in fields(kind):
        is_made = one.default_factory is not MISSING
        default = {"default_factory": one.default_factory} if is_made else {"default": one.default}
        keys[one.name] = (_form_of(hints[one.name]), Field(alias=KEYS.get(one.name), **default))
    return create_model(kind.__name__, __base__=_Table, **keys | further)


def _form_of(hint: Any) -> Any:
    """Return the type that is read from a file and becomes that of a field."""
    if is_dataclass(hint) and isinstance(hint, type):
        return Annotated[_table_of(hint), AfterValidator(lambda read: hint(**dict(read)))]
    return FORMS.get(hint, hint)


FORMS[Mapping[int, SurfacePerturbation]] = Annotated[
    dict[Annotated[str, Field(pattern=r"^[1-9]\d*$")], _form_of(SurfacePerturbation)],  # type: ignore[misc]
    AfterValidator(_by_index),
]
# In files of earlier versions, which lack this key, the errors of planes replace the z shift of the sensor.
_State = _table_of(SystemState, plane_distance_errors_add=(bool, False))


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
    if isinstance(value, SurfaceFigure):
        if value.trials is not None:
            raise InputError(f"state: {name}: holds the figures of several trials; a state describes one")
        return {
            "semi_diameter_mm": value.semi_diameter_mm,
            "spacing_mm": value.spacing_mm,
            "coefficients_mm": value.coefficients.tolist(),
        }
    if is_dataclass(value):
        return _deviations(value)
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
    values = dict(validate(_State, dict(table), Path(path)))
    count = len(lens.surfaces)
    for index in values["surface_perturbations"]:
        if index >= count:
            raise InputError(
                f"{path}: {STATE}: surfaces: {index + 1}: the lens has {count} surfaces; give the design to "
                "which the state belongs"
            )
    if not values.pop("plane_distance_errors_add"):
        shift_mm = values["sensor_shift_mm"][2]
        errors_mm = tuple(error - shift_mm for error in values["plane_distance_errors_mm"])
        values["plane_distance_errors_mm"] = errors_mm
    try:
        return SystemState(**values)
    except InputError as error:
        raise InputError(f"{path}: {STATE}: {error}") from None


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

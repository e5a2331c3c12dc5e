"""Parameters of a bench that may be unknown: names, units, and usual deviations from the design."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.common.toml_files import did_you_mean
from lensdesign.errors import InputError
from lensdesign.lens.glass import is_gap
from lensdesign.lens.lens import Lens
from lensdesign.lens.poses import SurfacePerturbation
from lensdesign.lens.surface_figure import surface_figure_from_zernike
from wavesim.calibration.mounting_parameters import (
    DECENTERS,
    PLANE_DISTANCE,
    RIGID,
    STOP_SHIFTS,
    TILTS,
    WORKING_DISTANCE,
    with_values,
)
from wavesim.scene.light_errors import Orders
from wavesim.scene.system_state import SLOPE_ORDERS, SystemState

Group = Literal["light", "lens", "mounting", "camera"]

FIGURE_TYPICAL_UM = 0.05
"""Usual root mean square of one Zernike term in um: 0.08 waves of a 633 nm interferometer."""

TYPICAL = {
    "index": 2e-3,
    "radius": 0.01,
    "thickness": 0.01,
    "decenter": 5e-3,
    "tilt_deg": 0.3,
    "distance": 0.01,
    "field_stop": 0.1,
}
"""Usual deviations for a lens whose object is 1 mm in front of it, relative or in mm.

Deviations of an equal number of waves are smaller for a larger lens. That of the field stop is relative to
the patch: nothing but the frames tells its position.
"""

LIGHT_WAVES, PHASE_WAVES, AMPLITUDE = 1.0, 0.15, 0.1
"""Usual deviations of the light over the patch: tilt and bend in waves, and relative unevenness."""

LIGHT_ORDER, LIGHT_ORDER_ALONE = 2, 4
"""Highest sum of orders of the light's modes with an unknown object, and without an object."""

LIGHT_MODE = re.compile(r"light_(amplitude|phase)_(\d)(\d)(?:_waves)?")

SHIFT_PIXELS, BACKGROUND = 2.0, 0.02
"""Usual shift of a plane in pixels, and background as a fraction of the mean intensity."""

EXPOSURE = 0.02
"""Usual relative error of the exposure of a plane, compared with that of the first plane."""

NONLINEARITY, NONLINEARITY_TYPICAL = "nonlinearity", 0.01
"""Parameter of the camera's nonlinearity, and its usual standard deviation."""

VIBRATION, VIBRATION_PIXELS = "vibration_variance_um2", 0.2
"""Parameter of the blur by vibration, and its usual standard deviation in pixels. The pictures change
linearly with the variance.
"""


@dataclass(frozen=True)
class Unknowns:
    """Values of the parameters that are sought, and a bench with all other values.

    Attributes
    ----------
    lens : Lens
        The nominal lens.
    fixed : SystemState
        State with the values that are not sought.
    values : mapping
        Values that are sought, by name.
    """

    lens: Lens
    fixed: SystemState = field(default_factory=SystemState)
    values: Mapping[str, float] = field(default_factory=dict)

    def changed(self, names: Sequence[str], values: Sequence[float]) -> Unknowns:
        """Return a copy with some values changed."""
        return replace(self, values={**self.values, **dict(zip(names, map(float, values), strict=True))})

    def of(self, names: Sequence[str]) -> Array:
        """Return values by name; a value that is not set is 0."""
        return np.array([self.values.get(name, 0.0) for name in names])

    @property
    def state(self) -> SystemState:
        """State of the system with these values."""
        result = self.fixed
        for add_group in (_with_light, _with_camera, _with_lens, _with_mounting):
            result = add_group(self, result)
        return result


@dataclass(frozen=True)
class Parameter:
    """A parameter of a bench that may be unknown.

    Attributes
    ----------
    name : str
        Name with its unit.
    group : {"light", "lens", "mounting", "camera"}
        Part of the bench to which it belongs.
    typical : float
        Expected standard deviation (prior).
    usual : float, optional
        Standard deviation of a usual bench, if it differs from `typical`.
    lower_bound : float
        Smallest possible value; at most 0.
    """

    name: str
    group: Group
    typical: float
    usual: float | None = None
    lower_bound: float = -math.inf

    @property
    def small(self) -> float:
        """Step over which the effect of the parameter is linear and well above rounding errors."""
        # Step of a parameter over its usual deviation; its effect is linear over this step.
        step_fraction = 0.05
        return step_fraction * (self.usual or self.typical)


def bench_parameters(
    lens: Lens, planes: int, patch_mm: float, wavelength_um: float, *, light_order: int = LIGHT_ORDER
) -> tuple[Parameter, ...]:
    """Return all parameters of a bench with their expected deviations.

    The first plane is the reference of the others. Its shift is the lens's decenter, and its distance the
    lens's despace.

    Parameters
    ----------
    lens
        The nominal lens.
    planes
        Number of planes.
    patch_mm
        Side of the object patch in mm.
    wavelength_um
        Vacuum wavelength in um.
    light_order
        Highest sum of orders of the light's modes. 0 excludes the light, which a complex object can imitate.

    Returns
    -------
    tuple of Parameter
        All parameters, in a fixed order.
    """
    found = list(_light_parameters(patch_mm, wavelength_um, light_order)) if light_order else []
    pitch_um, object_distance_mm = lens.sensor.pixel_pitch_um, abs(lens.object_z_mm)
    for n in range(1, planes + 1):
        if n > 1:
            found += [
                Parameter(f"plane_{n}_shift_{axis}_um", "camera", SHIFT_PIXELS * pitch_um) for axis in "xy"
            ]
            found.append(Parameter(PLANE_DISTANCE.format(n), "camera", TYPICAL["distance"]))
            found.append(Parameter(f"plane_{n}{EXPOSURE_ERROR}", "camera", EXPOSURE))
        found.append(Parameter(f"plane_{n}_background", "camera", BACKGROUND))
        found += [Parameter(f"plane_{n}_background_slope_{axis}", "camera", BACKGROUND) for axis in "xy"]
    found.append(Parameter(NONLINEARITY, "camera", NONLINEARITY_TYPICAL))
    found.append(Parameter(VIBRATION, "camera", (VIBRATION_PIXELS * pitch_um) ** 2, lower_bound=0.0))
    half_mm = 0.5e-3 * pitch_um * max(lens.sensor.pixels)
    tilt_deg = math.degrees(TYPICAL["distance"] / half_mm)
    found += [Parameter(name, "camera", tilt_deg) for name in SENSOR_TILTS]
    # Relative errors with an equal effect in waves decrease with the size of the lens.
    fraction = min(1.0, 1.0 / object_distance_mm)
    found += _lens_parameters(lens, fraction)
    found += [Parameter(name, "mounting", TYPICAL["decenter"]) for name in DECENTERS]
    found += [Parameter(name, "mounting", TYPICAL["tilt_deg"] * fraction) for name in TILTS]
    found.append(Parameter(WORKING_DISTANCE, "mounting", TYPICAL["distance"]))
    return tuple(found)


def field_stop_parameters(patch_mm: float) -> tuple[Parameter, ...]:
    """Return the parameters of a field stop whose position was found from the frames.

    Parameters
    ----------
    patch_mm
        Side of the object patch in mm.
    """
    return tuple(Parameter(name, "mounting", TYPICAL["field_stop"] * patch_mm) for name in STOP_SHIFTS)


def all_names(lens: Lens) -> tuple[str, ...]:
    """Return the names of all parameters that a lens and its bench can have."""
    most_planes = 99
    found = bench_parameters(lens, most_planes, 1.0, 1.0, light_order=LIGHT_ORDER_ALONE)
    return *(p.name for p in found), *STOP_SHIFTS


def with_priors(
    parameters: Sequence[Parameter], priors: Mapping[str, float], allowed: Sequence[str]
) -> tuple[Parameter, ...]:
    """Return parameters with other expected standard deviations.

    Parameters
    ----------
    parameters
        Parameters that are sought.
    priors
        Standard deviations by name; other parameters stay as they are.
    allowed
        Names that exist.

    Raises
    ------
    InputError
        If a name does not exist, or a standard deviation is not above 0.
    """
    for name, deviation in priors.items():
        if name not in allowed:
            raise InputError(f"priors: {name!r}: no such parameter{did_you_mean(name, allowed)}")
        if not 0.0 < deviation < math.inf:
            raise InputError(f"priors: {name} = {deviation!r}: must be finite and above 0")
    return tuple(
        replace(p, typical=priors[p.name], usual=p.typical) if p.name in priors else p for p in parameters
    )


def chosen_parameters(text: str, allowed: Sequence[Parameter]) -> tuple[Parameter, ...]:
    """Return the requested parameters: all, groups (light, lens, mounting, camera), or names, separated by
    commas.

    Raises
    ------
    InputError
        If a name is unknown or is given twice.
    """
    names_and_groups = [word.strip() for word in text.split(",") if word.strip()]
    parts = {parameter.group for parameter in allowed}
    names = [parameter.name for parameter in allowed]
    chosen: list[Parameter] = []
    for word in names_and_groups:
        found = [
            p for p in allowed if word in ("all", p.group, p.name) or (word == "rigid" and p.name in RIGID)
        ]
        if not found:
            raise InputError(
                f"parameter {word!r}: unknown; allowed: all, rigid, {', '.join(sorted(parts))}, or "
                f"{', '.join(names)}{did_you_mean(word, names)}"
            )
        chosen += found
    if not chosen or len({p.name for p in chosen}) < len(chosen):
        raise InputError(f"parameters = {text!r}: must be one or more, each once")
    return tuple(p for p in allowed if p in chosen)


EXPOSURE_ERROR = "_exposure_error"
"""End of the names of parameters of exposures."""

SENSOR_TILTS = ("sensor_tilt_x_deg", "sensor_tilt_y_deg")


def light_orders(name: str) -> Orders:
    """Return the orders of the mode of the light that a parameter changes; a tilt is a mode of the phase,
    too.
    """
    match = LIGHT_MODE.fullmatch(name)
    if match is None:
        return (1, 0) if name == "light_tilt_x_deg" else (0, 1)
    return int(match[2]), int(match[3])


def background_orders(name: str) -> Orders | None:
    """Return the orders of the polynomial of a plane's background that a parameter changes, or None."""
    _, separator, slope = name.partition("_background")
    if not separator:
        return None
    return SLOPE_ORDERS["xy".index(slope[-1])] if slope else (0, 0)


def _light_parameters(patch_mm: float, wavelength_um: float, order: int) -> list[Parameter]:
    tilt_deg = math.degrees(1e-3 * LIGHT_WAVES * wavelength_um / patch_mm)
    return [
        *(Parameter(f"light_tilt_{axis}_deg", "light", tilt_deg) for axis in "xy"),
        *(Parameter(f"light_phase_{i}{j}_waves", "light", PHASE_WAVES) for i, j in _orders(2, order)),
        *(Parameter(f"light_amplitude_{i}{j}", "light", AMPLITUDE) for i, j in _orders(1, order)),
    ]


def _orders(least: int, most: int) -> list[Orders]:
    """Return the orders of modes, sorted by their sum; the first orders of the phase are the tilt."""
    return [(total - j, j) for total in range(least, most + 1) for j in range(total + 1)]


def _lens_parameters(lens: Lens, fraction: float) -> list[Parameter]:
    found = []
    # Zernike terms of a surface's figure by OSA/ANSI index: two of astigmatism, two of coma.
    figure_terms = (3, 5, 7, 8)
    for surface_number, surface in enumerate(lens.surfaces, start=1):
        prefix = f"surface_{surface_number}_"
        if not is_gap(surface.material):
            found.append(Parameter(f"{prefix}index", "lens", TYPICAL["index"] * fraction))
        if surface.radius_mm and math.isfinite(surface.radius_mm):
            found.append(
                Parameter(f"{prefix}radius_mm", "lens", TYPICAL["radius"] * fraction * abs(surface.radius_mm))
            )
        if surface_number < len(lens.surfaces):
            found.append(Parameter(f"{prefix}thickness_mm", "lens", TYPICAL["thickness"]))
        if surface.semi_diameter_mm is not None:
            found += [Parameter(f"{prefix}figure_{j}_um", "lens", FIGURE_TYPICAL_UM) for j in figure_terms]
    return found


def _with_light(unknowns: Unknowns, state: SystemState) -> SystemState:
    values, light = unknowns.values, state.light
    modes = {"amplitude": dict(light.amplitude), "phase": dict(light.phase_waves)}
    for name, value in values.items():
        if match := LIGHT_MODE.fullmatch(name):
            modes[match[1]][light_orders(name)] = value
    tilt_deg = _pair(values, "light_tilt_{}_deg", light.tilt_deg)
    found = replace(light, tilt_deg=tilt_deg, amplitude=modes["amplitude"], phase_waves=modes["phase"])
    return replace(state, light=found)


def _with_camera(unknowns: Unknowns, state: SystemState) -> SystemState:
    values = unknowns.values
    planes = max(
        (int(n.split("_")[1]) for n in values if n.startswith("plane_") and "_distance_" not in n), default=0
    )
    shifts = _extended(state.plane_shifts_um, planes, (0.0, 0.0))
    backgrounds = _extended(state.plane_backgrounds, planes, 0.0)
    slopes = _extended(state.plane_background_slopes, planes, (0.0, 0.0))
    exposures = _extended(state.plane_exposure_errors, planes, 0.0)
    for n in range(planes):
        shifts[n] = _pair(values, f"plane_{n + 1}_shift_{{}}_um", shifts[n])
        slopes[n] = _pair(values, f"plane_{n + 1}_background_slope_{{}}", slopes[n])
        exposures[n] = values.get(f"plane_{n + 1}{EXPOSURE_ERROR}", exposures[n])
        backgrounds[n] = max(values.get(f"plane_{n + 1}_background", backgrounds[n]), 0.0)
    variance = values.get(VIBRATION, state.vibration_um**2)
    return replace(
        state,
        plane_shifts_um=tuple(shifts),
        plane_backgrounds=tuple(backgrounds),
        plane_background_slopes=tuple(slopes) if any(map(any, slopes)) else (),
        plane_exposure_errors=tuple(exposures) if any(exposures) else (),
        nonlinearity=values.get(NONLINEARITY, state.nonlinearity),
        vibration_um=math.sqrt(max(variance, 0.0)),
    )


def _extended(values: Sequence[Any], count: int, default: Any) -> list[Any]:
    """Return values with a default up to a number of planes."""
    return [*values, *(default,) * (count - len(values))]


def _pair(values: Mapping[str, float], name: str, own: tuple[float, float]) -> tuple[float, float]:
    """Return the values along x and y of a parameter, or those of the state."""
    return values.get(name.format("x"), own[0]), values.get(name.format("y"), own[1])


def _with_lens(unknowns: Unknowns, state: SystemState) -> SystemState:
    deltas = dict(state.surface_perturbations)
    for n, surface in enumerate(unknowns.lens.surfaces):
        prefix = f"surface_{n + 1}_"
        changes = {
            name[len(prefix) :]: v for name, v in unknowns.values.items() if name.startswith(prefix) and v
        }
        terms = {
            int(name.split("_")[1]): changes.pop(name) for name in list(changes) if name.startswith("figure_")
        }
        perturbation: dict[str, Any] = dict(changes)
        if terms:
            assert surface.semi_diameter_mm is not None
            perturbation["figure"] = surface_figure_from_zernike(terms, surface.semi_diameter_mm)
        if perturbation:
            deltas[n] = replace(deltas.get(n, SurfacePerturbation()), **perturbation)
    return replace(state, surface_perturbations=deltas)


def _with_mounting(unknowns: Unknowns, state: SystemState) -> SystemState:
    names = [
        n
        for n in unknowns.values
        if n in (*RIGID, WORKING_DISTANCE, *STOP_SHIFTS) or n.startswith(PLANE_DISTANCE.split("{}")[0])
    ]
    tilt_deg = _pair(unknowns.values, "sensor_tilt_{}_deg", state.sensor_tilt_deg)
    state = replace(state, sensor_tilt_deg=tilt_deg)
    return with_values(state, names, unknowns.of(names).tolist()) if names else state

"""Parameters of a bench that may be unknown: what each changes, and its usual deviation from the design."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from typing import Any, ClassVar, Literal

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.common.toml_files import did_you_mean
from lensdesign.errors import InputError
from lensdesign.lens.glass import is_gap
from lensdesign.lens.lens import Lens
from lensdesign.lens.poses import SurfacePerturbation
from lensdesign.lens.surface_figure import SurfaceFigure, surface_figure_from_zernike
from wavesim.forward.linear_model import FreeSpaceMeasurement, LinearModel, RealArray
from wavesim.forward.stacked_channels import ChannelsMeasurement
from wavesim.scene.light_errors import Orders
from wavesim.scene.system_state import SLOPE_ORDERS, SystemState

Group = Literal["light", "lens", "mounting", "camera"]
WORKING_DISTANCE = "working_distance_mm"
"""Name of the parameter of the object's distance from the lens."""

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

SHIFT_PIXELS, BACKGROUND = 2.0, 0.02
"""Usual shift of a plane in pixels, and background as a fraction of the mean intensity."""

EXPOSURE = 0.02
"""Usual relative error of the exposure of a plane, compared with that of the first plane."""

NONLINEARITY, VIBRATION_PIXELS = 0.01, 0.2
"""Usual standard deviations of the camera's nonlinearity, and of the blur by vibration in pixels."""


@dataclass(frozen=True)
class Parameter:
    """A parameter of a bench that may be unknown: a number in its state; equal are those of one name.

    The path to the number consists of attributes, keys and indices.
    """

    name: str
    path: tuple[Any, ...] = field(compare=False)
    typical: float = field(compare=False)  # expected standard deviation (prior)
    usual: float | None = field(default=None, compare=False)  # that of a usual bench, if it differs

    group: ClassVar[Group]
    lower_bound: ClassVar[float] = -math.inf  # smallest possible value, at most 0
    displaces: ClassVar[bool] = True  # whether it can displace the light of a field stop
    follows_object: ClassVar[bool] = False  # whether it changes with an object that is displaced
    is_sought_last: ClassVar[bool] = False  # because it can imitate others, or is determined least

    def value(self, state: SystemState) -> float:
        """Return the value that a state has."""
        return float(_at(state, self.path))

    def set(self, state: SystemState, value: float) -> SystemState:
        """Return a state with another value."""
        changed: SystemState = _replaced(state, self.path, value)
        return changed

    def column(self, linear: LinearModel) -> RealArray:
        """Return the change of the modelled amplitudes per unit, of a parameter that acts behind the lens."""
        raise AssertionError(f"{self.name}: acts on the light or the rays")

    @property
    def small(self) -> float:
        """Step over which the effect of the parameter is linear and well above rounding errors."""
        # Step of a parameter over its usual deviation; its effect is linear over this step.
        step_fraction = 0.05
        return step_fraction * (self.usual or self.typical)


class LightPhase(Parameter):
    """A mode of the phase of the light on the object, in waves."""

    group = "light"

    @property
    def orders(self) -> Orders:
        """Orders of the mode."""
        orders: Orders = self.path[-1]
        return orders


class LightAmplitude(LightPhase):
    """A mode of the relative amplitude of the light."""

    is_sought_last = True


class LightTilt(LightPhase):
    """Tilt of the light in deg, which is a mode of first order of its phase."""

    follows_object = True

    @property
    def orders(self) -> Orders:
        return SLOPE_ORDERS[self.path[-1]]


class CameraParameter(Parameter):
    """A parameter of the camera."""

    group = "camera"

    @property
    def plane(self) -> int:
        """Index of the plane, for parameters of one plane."""
        return int(self.path[1])


class SensorPosition(CameraParameter):
    """A parameter of the sensor's position."""


class PlaneShift(SensorPosition):
    """Lateral shift of the sensor on a plane in um."""

    follows_object = True

    def column(self, linear: LinearModel) -> RealArray:
        products = _measurement(linear).by_shift(self.plane, self.path[-1])
        return linear.amplitude_change_on_plane(self.plane, products)


class PlaneDistance(SensorPosition):
    """Distance of the sensor from the lens on a plane in mm, the true minus the nominal one."""

    def column(self, linear: LinearModel) -> RealArray:
        return linear.amplitude_change_on_plane(self.plane, _measurement(linear).by_distance(self.plane))


class SensorTilt(SensorPosition):
    """Tilt of the sensor about an axis in deg."""

    is_sought_last = True

    def column(self, linear: LinearModel) -> RealArray:
        return linear.amplitude_changes(_measurement(linear).by_tilt(self.path[-1]))


class ExposureError(CameraParameter):
    """Relative error of the exposure of a plane."""

    def column(self, linear: LinearModel) -> RealArray:
        return linear.jacobian_times_exposure(self.plane)


class Background(CameraParameter):
    """Even background of a plane as a fraction of its mean intensity."""

    displaces = False

    def set(self, state: SystemState, value: float) -> SystemState:
        return super().set(state, max(value, 0.0))

    def column(self, linear: LinearModel) -> RealArray:
        return linear.jacobian_times_background(self.plane)


class BackgroundSlope(CameraParameter):
    """Change of a plane's background from its centre to its edge along an axis, in the same unit."""

    displaces = False

    def column(self, linear: LinearModel) -> RealArray:
        return linear.jacobian_times_background(self.plane, SLOPE_ORDERS[self.path[-1]])


class Nonlinearity(CameraParameter):
    """Nonlinearity of the camera."""

    def column(self, linear: LinearModel) -> RealArray:
        return linear.jacobian_times_nonlinearity()


class Vibration(CameraParameter):
    """Variance of the sensor's vibration in um^2, with which the pictures change linearly."""

    lower_bound = 0.0
    displaces = False

    def value(self, state: SystemState) -> float:
        return super().value(state) ** 2

    def set(self, state: SystemState, value: float) -> SystemState:
        return super().set(state, math.sqrt(max(value, 0.0)))

    def column(self, linear: LinearModel) -> RealArray:
        return linear.amplitude_changes(_measurement(linear).by_blur())


class SurfaceChange(Parameter):
    """Deviation of a surface's index, radius or thickness."""

    group = "lens"


@dataclass(frozen=True)
class FigureTerm(SurfaceChange):
    """Root mean square of a Zernike term of a surface's figure in um, by its OSA/ANSI index."""

    index: int = field(kw_only=True)
    semi_diameter_mm: float = field(kw_only=True)

    def value(self, state: SystemState) -> float:
        return self._terms_um(state).get(self.index, 0.0)

    def set(self, state: SystemState, value: float) -> SystemState:
        terms = {n: um for n, um in {**self._terms_um(state), self.index: value}.items() if um}
        figure = _figure_of_terms(tuple(terms.items()), self.semi_diameter_mm) if terms else None
        changed: SystemState = _replaced(state, self.path, figure)
        return changed

    def _terms_um(self, state: SystemState) -> Mapping[int, float]:
        figure = _at(state, self.path)
        return figure.terms_um if isinstance(figure, _FigureOfTerms) else {}


class LensPose(Parameter):
    """Tilt of the whole lens about an axis in deg."""

    group = "mounting"


class Decenter(LensPose):
    """Decenter of the lens in mm."""

    follows_object = True


class WorkingDistance(Parameter):
    """Distance of the object from the lens in mm, the true minus the nominal one."""

    group = "mounting"

    def value(self, state: SystemState) -> float:
        return 0.0 - super().value(state)

    def set(self, state: SystemState, value: float) -> SystemState:
        return super().set(state, 0.0 - value)


class StopShift(Parameter):
    """Shift of the field stop in mm, together with the object, from a position found from the frames."""

    group = "mounting"
    follows_object = True


@dataclass(frozen=True)
class Unknowns:
    """Values of the parameters that are sought, and a bench with all other values."""

    fixed: SystemState = field(default_factory=SystemState)
    values: Mapping[Parameter, float] = field(default_factory=dict)

    def changed(self, parameters: Sequence[Parameter], values: Sequence[float]) -> Unknowns:
        """Return a copy with some values changed."""
        return replace(self, values={**self.values, **dict(zip(parameters, map(float, values), strict=True))})

    def of(self, parameters: Sequence[Parameter]) -> Array:
        """Return values of parameters; a value that is not set is 0."""
        return np.array([self.values.get(parameter, 0.0) for parameter in parameters])

    @cached_property
    def state(self) -> SystemState:
        """State of the system with these values."""
        result = self.fixed
        for parameter, value in self.values.items():
            if parameter.value(result) != value:  # what is as designed stays so
                result = parameter.set(result, value)
        return result


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
    found = _light_parameters(patch_mm, wavelength_um, light_order) if light_order else []
    pitch_um = lens.sensor.pixel_pitch_um
    for plane in range(planes):
        head = f"plane_{plane + 1}_"
        if plane > 0:
            for n, axis in enumerate("xy"):
                path = "plane_shifts_um", plane, n
                found.append(PlaneShift(f"{head}shift_{axis}_um", path, SHIFT_PIXELS * pitch_um))
            found.append(_plane_distance(plane))
            found.append(ExposureError(f"{head}exposure_error", ("plane_exposure_errors", plane), EXPOSURE))
        found.append(Background(f"{head}background", ("plane_backgrounds", plane), BACKGROUND))
        for n, axis in enumerate("xy"):
            path = "plane_background_slopes", plane, n
            found.append(BackgroundSlope(f"{head}background_slope_{axis}", path, BACKGROUND))
    found.append(Nonlinearity("nonlinearity", ("nonlinearity",), NONLINEARITY))
    found.append(Vibration("vibration_variance_um2", ("vibration_um",), (VIBRATION_PIXELS * pitch_um) ** 2))
    half_mm = 0.5e-3 * pitch_um * max(lens.sensor.pixels)
    tilt_deg = math.degrees(TYPICAL["distance"] / half_mm)
    found += [
        SensorTilt(f"sensor_tilt_{axis}_deg", ("sensor_tilt_deg", n), tilt_deg) for n, axis in enumerate("xy")
    ]
    return *found, *_lens_parameters(lens), *_pose_parameters(lens)


def mounting_parameters(lens: Lens, planes: int) -> tuple[Parameter, ...]:
    """Return the parameters that frames of a known object determine: pose of the lens, and distances."""
    return *_pose_parameters(lens), *map(_plane_distance, range(planes))


def field_stop_parameters(patch_mm: float) -> tuple[Parameter, ...]:
    """Return the parameters of a field stop whose position was found from the frames."""
    typical_mm = TYPICAL["field_stop"] * patch_mm
    return tuple(
        StopShift(f"field_stop_shift_{axis}_mm", ("object_shift_mm", n), typical_mm)
        for n, axis in enumerate("xy")
    )


def parameters_by_name(lens: Lens) -> dict[str, Parameter]:
    """Return all parameters that a lens and its bench can have, by their names."""
    most_planes = 99
    found = bench_parameters(lens, most_planes, 1.0, 1.0, light_order=LIGHT_ORDER_ALONE)
    return {p.name: p for p in (*found, *field_stop_parameters(1.0))}


def with_priors(
    parameters: Sequence[Parameter], priors: Mapping[str, float], allowed: Collection[str]
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
            p
            for p in allowed
            if word in ("all", p.group, p.name) or (word == "rigid" and isinstance(p, LensPose))
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


def _light_parameters(patch_mm: float, wavelength_um: float, order: int) -> list[Parameter]:
    tilt_deg = math.degrees(1e-3 * LIGHT_WAVES * wavelength_um / patch_mm)
    return [
        *(
            LightTilt(f"light_tilt_{axis}_deg", ("light", "tilt_deg", n), tilt_deg)
            for n, axis in enumerate("xy")
        ),
        *(
            LightPhase(f"light_phase_{i}{j}_waves", ("light", "phase_waves", (i, j)), PHASE_WAVES)
            for i, j in _orders(2, order)
        ),
        *(
            LightAmplitude(f"light_amplitude_{i}{j}", ("light", "amplitude", (i, j)), AMPLITUDE)
            for i, j in _orders(1, order)
        ),
    ]


def _orders(least: int, most: int) -> list[Orders]:
    """Return the orders of modes, sorted by their sum; the first orders of the phase are the tilt."""
    return [(total - j, j) for total in range(least, most + 1) for j in range(total + 1)]


def _plane_distance(plane: int) -> PlaneDistance:
    path = "plane_distance_errors_mm", plane
    return PlaneDistance(f"plane_distance_{plane + 1}_mm", path, TYPICAL["distance"])


def _size_fraction(lens: Lens) -> float:
    """Return the factor of relative errors; those of an equal effect in waves decrease with the size."""
    return min(1.0, 1.0 / abs(lens.object_z_mm))


def _lens_parameters(lens: Lens) -> list[Parameter]:
    found: list[Parameter] = []
    # Zernike terms of a surface's figure by OSA/ANSI index: two of astigmatism, two of coma.
    figure_terms, fraction = (3, 5, 7, 8), _size_fraction(lens)
    for n, surface in enumerate(lens.surfaces):
        typical = {}
        if not is_gap(surface.material):
            typical["index"] = TYPICAL["index"] * fraction
        if surface.radius_mm and math.isfinite(surface.radius_mm):
            typical["radius_mm"] = TYPICAL["radius"] * fraction * abs(surface.radius_mm)
        if n + 1 < len(lens.surfaces):
            typical["thickness_mm"] = TYPICAL["thickness"]
        head, path = f"surface_{n + 1}_", ("surface_perturbations", n)
        found += [SurfaceChange(head + one, (*path, one), size) for one, size in typical.items()]
        if (semi_mm := surface.semi_diameter_mm) is not None:
            given = (*path, "figure"), FIGURE_TYPICAL_UM
            found += [
                FigureTerm(f"{head}figure_{j}_um", *given, index=j, semi_diameter_mm=semi_mm)
                for j in figure_terms
            ]
    return found


def _pose_parameters(lens: Lens) -> list[Parameter]:
    tilt_deg = TYPICAL["tilt_deg"] * _size_fraction(lens)
    return [
        *(Decenter(name, ("pose", name), TYPICAL["decenter"]) for name in ("decenter_x_mm", "decenter_y_mm")),
        *(LensPose(name, ("pose", name), tilt_deg) for name in ("tilt_x_deg", "tilt_y_deg")),
        WorkingDistance(WORKING_DISTANCE, ("object_shift_mm", 2), TYPICAL["distance"]),
    ]


def _measurement(linear: LinearModel) -> FreeSpaceMeasurement | ChannelsMeasurement:
    """Return the measurement of planes that are reached through free space."""
    assert isinstance(linear.measurement, FreeSpaceMeasurement | ChannelsMeasurement)
    return linear.measurement


def _part(whole: Any, path: tuple[Any, ...]) -> Any:
    """Return what a state, or a part of it, has at the first step of a path."""
    key, inner = path[0], path[1:]
    if isinstance(whole, Mapping):
        return whole.get(key, _as_designed(inner))
    if isinstance(whole, tuple):
        return whole[key] if key < len(whole) else _as_designed(inner)
    return getattr(whole, key)


def _at(whole: Any, path: tuple[Any, ...]) -> Any:
    return _at(_part(whole, path), path[1:]) if path else whole


def _replaced(whole: Any, path: tuple[Any, ...], value: Any) -> Any:
    """Return a state, or a part of it, with another value at a path."""
    if not path:
        return value
    key, inner = path[0], path[1:]
    changed = _replaced(_part(whole, path), inner, value)
    if isinstance(whole, Mapping):
        return {**whole, key: changed}
    if isinstance(whole, tuple):
        before = (*whole[:key], *(_as_designed(inner) for _ in range(key - len(whole))))
        return (*before, changed, *whole[key + 1 :])
    return replace(whole, **{key: changed})


def _as_designed(path: tuple[Any, ...]) -> Any:
    """Return the value of a state's part that is as designed: a number, a pair, or a change of a surface."""
    if not path:
        return 0.0
    return SurfacePerturbation() if isinstance(path[0], str) else (0.0, 0.0)


@dataclass(frozen=True, eq=False)
class _FigureOfTerms(SurfaceFigure):
    """Figure of a surface that knows its Zernike terms in um."""

    terms_um: Mapping[int, float]


@lru_cache(maxsize=64)
def _figure_of_terms(terms_um: tuple[tuple[int, float], ...], semi_diameter_mm: float) -> _FigureOfTerms:
    """Return a figure; benches that are compared differ in few of their figures."""
    figure = surface_figure_from_zernike(dict(terms_um), semi_diameter_mm)
    return _FigureOfTerms(
        figure.semi_diameter_mm, figure.spacing_mm, figure.coefficients, terms_um=dict(terms_um)
    )

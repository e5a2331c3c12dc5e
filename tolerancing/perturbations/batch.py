"""Sampled perturbations: from drawn deltas to the lens, object, sensor and light of each trial."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.lens.lens import Lens
from lensdesign.lens.poses import SURFACE_DELTAS, Pose, SurfacePerturbation
from lensdesign.lens.surface_figure import SurfaceFigure
from tolerancing.perturbations.elements import element_deltas, runout_tilt
from tolerancing.perturbations.environment import heat_deltas, heat_shifts_mm
from tolerancing.perturbations.parameters import (
    IRREGULARITIES,
    LENS_PARAMETERS,
    RADII,
    RUNOUTS,
    SHAPE_PARAMETERS,
    TILTS,
    PerturbedParameter,
)
from wavesim.scene.system_state import SystemState

LATERAL = ("decenter_x_mm", "decenter_y_mm")


@dataclass(frozen=True, eq=False)
class PerturbationBatch:
    """Sampled deviations of several trials, from :func:`tolerancing.sample_perturbations`.

    Attributes
    ----------
    parameters : tuple of PerturbedParameter
        Perturbed parameters, one for each column of `values`. Columns of the same parameter add up.
    values : ndarray, shape (trials, parameters)
        Deviations from nominal, in the units of the parameters.
    pivot_z_mm
        Position on the axis about which the whole lens tilts, in mm from its front vertex.
    shapes : mapping of int to ndarray
        Random sag errors of the trials for each column of an irregularity: Zernike coefficients of shape
        (trials, terms).
    trial_numbers : tuple of int
        Numbers of the trials in their study; empty if the trials have no numbers.
    origin : tuple of PerturbationBatch and int, or None
        For a batch of one trial, the batch from which it was selected and its index there.

    Examples
    --------
    >>> from tolerancing import load_study, sample_perturbations
    >>> batch = sample_perturbations(load_study("designs/as_built_tolerances.toml").study, [0, 1])
    >>> len(batch), batch.parameters[0].column, batch.poses().decenter_x_mm.round(4).tolist()
    (2, 'lens_decenter_x_mm', [0.0046, -0.0192])
    """

    parameters: tuple[PerturbedParameter, ...]
    values: Array
    pivot_z_mm: float = 0.0
    shapes: Mapping[int, Array] = field(default_factory=dict)
    trial_numbers: tuple[int, ...] = ()
    origin: tuple[PerturbationBatch, int] | None = None

    def __len__(self) -> int:
        return len(self.values)

    def trial(self, i: int) -> PerturbationBatch:
        """Return a batch of one of these trials, counted from 0 within the batch."""
        one = slice(i, i + 1)
        shapes = {column: shape[one] for column, shape in self.shapes.items()}
        return PerturbationBatch(
            self.parameters, self.values[one], self.pivot_z_mm, shapes, self.trial_numbers[one], (self, i)
        )

    def subset(self, rows: slice) -> PerturbationBatch:
        """Return a batch of some of these trials, which shares no cached results with this batch."""
        return replace(
            self,
            values=self.values[rows],
            shapes={column: shape[rows] for column, shape in self.shapes.items()},
            trial_numbers=self.trial_numbers[rows],
            origin=None,
        )

    def single_trials(self) -> list[PerturbationBatch]:
        """Return one batch for each of these trials."""
        return [self.trial(i) for i in range(len(self))]

    def poses(self) -> Pose:
        """Return the poses of the lens, each perturbed value of shape (trials,)."""
        deltas = {name: self._sum("lens", name) for name in LENS_PARAMETERS if self._has("lens", name)}
        return Pose(**deltas, pivot_z_mm=self.pivot_z_mm)

    def surface_perturbations(self, lens: Lens, wavelength_um: float) -> dict[int, SurfacePerturbation]:
        """Return perturbations by surface index, each perturbed value of shape (trials,).

        Parameters
        ----------
        lens
            The nominal lens.
        wavelength_um
            The nominal vacuum wavelength. A perturbed wavelength enters as a change of the indices.
        """
        deltas: dict[int, dict[str, Any]] = {}

        def add(surface: int, name: str, value: Any) -> None:
            own = deltas.setdefault(surface, {})
            own[name] = own[name] + value if name in own else value

        for column, parameter in enumerate(self.parameters):
            surface, name = parameter.surface, parameter.parameter
            if surface is None:
                continue
            value = np.ascontiguousarray(self.values[:, column])
            if name in RADII:
                value = radius_delta_mm(lens, surface, name, value)
                add(surface, RADII[name], value)
            elif name in SURFACE_DELTAS or name in SHAPE_PARAMETERS:
                add(surface, name, value)
            elif name in IRREGULARITIES:
                self._add_surface_figure(deltas.setdefault(surface, {}), lens, surface, column)
            elif name in RUNOUTS:
                add(surface, *runout_tilt(lens, surface, name, value))
            else:  # abbe_percent
                add(surface, "index", abbe_index_delta(lens, surface, wavelength_um, value))
        for column, parameter in self._heated():
            change, mount = self.values[:, column], parameter.mount_expansion_per_k
            for surface, name, value in heat_deltas(lens, change, mount, wavelength_um):
                add(surface, name, np.ascontiguousarray(value))
        for surface, name, value in element_deltas(lens, self.parameters, self.values):
            add(surface, name, np.ascontiguousarray(value))
        if self._has("light", "wavelength_um"):
            for surface, change in self._dispersion(lens, wavelength_um).items():
                add(surface, "index", change)
        return {surface: _perturbed(own) for surface, own in sorted(deltas.items())}

    def object_shift_mm(self, lens: Lens) -> Array:
        """Return the shift of the object from its nominal position, shape (trials, 3)."""
        lateral = [self._sum("object", name) for name in LATERAL]
        away = self._sum("object", "working_distance_mm")
        for column, parameter in self._heated():
            away += heat_shifts_mm(lens, self.values[:, column], parameter.mount_expansion_per_k)[0]
        return np.column_stack([*lateral, -away])

    def sensor_shift_mm(self, lens: Lens) -> Array:
        """Return the shift of the sensor from its nominal position, shape (trials, 3).

        If the planes have different distance errors, the shift along z is their mean, because the field that
        is retrieved from the planes has a single position.
        """
        along = self.plane_distances_mm(lens).mean(axis=1)
        return np.column_stack([*(self._sum("sensor", name) for name in LATERAL), along])

    def plane_distances_mm(self, lens: Lens) -> Array:
        """Return the error of each plane's distance from the lens, shape (trials, planes)."""
        common, planes = self._sum("sensor", "distance_mm"), len(lens.sensor.plane_distances_mm)
        errors = np.column_stack(
            [common + self._sum("sensor", f"plane_distance_{n}_mm") for n in range(1, planes + 1)]
        )
        for column, parameter in self._heated():
            errors += heat_shifts_mm(lens, self.values[:, column], parameter.mount_expansion_per_k)[1]
        return errors

    def sensor_tilt_deg(self) -> Array:
        """Return the tilts of the sensor about x and y, shape (trials, 2)."""
        return np.column_stack([self._sum("sensor", name) for name in TILTS])

    def wavelength_shift_um(self) -> Array:
        """Return the deviation of the wavelength from nominal, shape (trials,)."""
        return self._sum("light", "wavelength_um")

    def reconstruction_slices(self) -> Array:
        """Return the number of slices of the reconstruction, shape (trials,); 0 means the merit's default."""
        return self._sum("reconstruction", "slices")

    @property
    def moves_rays(self) -> bool:
        """True if the object, the sensor or the temperature is perturbed."""
        return any(p.target in ("object", "sensor", "environment") for p in self.parameters)

    def states(self, lens: Lens, wavelength_um: float) -> list[SystemState]:
        """Return the perturbed systems, one for each trial, each with its wavelength."""
        poses, surfaces = vars(self.poses()), self.surface_perturbations(lens, wavelength_um)
        sensor_mm, planes_mm = self.sensor_shift_mm(lens), self.plane_distances_mm(lens)
        errors_mm, object_mm = planes_mm - sensor_mm[:, 2:], self.object_shift_mm(lens)
        tilts_deg, wavelengths_um = self.sensor_tilt_deg(), wavelength_um + self.wavelength_shift_um()
        return [
            SystemState(
                pose=Pose(**_of_trial(poses, i)),
                surface_perturbations={
                    surface: SurfacePerturbation(**_of_trial(vars(own), i))
                    for surface, own in surfaces.items()
                },
                object_shift_mm=tuple(object_mm[i].tolist()),
                sensor_shift_mm=tuple(sensor_mm[i].tolist()),
                plane_distance_errors_mm=tuple(errors_mm[i].tolist()) if np.any(errors_mm[i]) else (),
                sensor_tilt_deg=tuple(tilts_deg[i].tolist()),
                wavelength_um=float(wavelengths_um[i]),
            )
            for i in range(len(self))
        ]

    def _heated(self) -> list[tuple[int, PerturbedParameter]]:
        """Return the columns that perturb the temperature, with their indices."""
        return [(k, p) for k, p in enumerate(self.parameters) if p.target == "environment"]

    def _has(self, target: str, name: str) -> bool:
        return any(p.target == target and p.parameter == name for p in self.parameters)

    def _sum(self, target: str, name: str) -> Array:
        chosen = [k for k, p in enumerate(self.parameters) if p.target == target and p.parameter == name]
        return np.ascontiguousarray(self.values[:, chosen].sum(axis=1))

    def _add_surface_figure(self, own: dict[str, Any], lens: Lens, surface: int, column: int) -> None:
        from tolerancing.perturbations.irregularity import random_surface_figures

        semi_diameter = lens.surfaces[surface].semi_diameter_mm
        assert semi_diameter is not None  # guaranteed by PerturbedParameter.check
        quantity = self.parameters[column].parameter.split("_")[1]
        figure = random_surface_figures(self.shapes[column], self.values[:, column], quantity, semi_diameter)
        if "figure" in own:
            coefficients = own["figure"].coefficients + figure.coefficients
            figure = type(figure)(figure.semi_diameter_mm, figure.spacing_mm, coefficients)
        own["figure"] = figure

    def _dispersion(self, lens: Lens, wavelength_um: float) -> dict[int, Array]:
        """Return the change of index behind each surface that follows from perturbed wavelengths."""
        shifts, inverse = np.unique(self.wavelength_shift_um(), return_inverse=True)
        nominal = lens.indices(wavelength_um)
        changes = np.stack([lens.indices(wavelength_um + shift) - nominal for shift in shifts])[inverse]
        return {i: changes[:, i + 1] for i in range(len(lens.surfaces)) if np.any(changes[:, i + 1])}


def _perturbed(deltas: Mapping[str, Any]) -> SurfacePerturbation:
    """Return a surface's perturbation from deltas by parameter name."""
    named = vars(SurfacePerturbation())
    shape = {name: delta for name, delta in deltas.items() if name not in named}
    return SurfacePerturbation(**{n: delta for n, delta in deltas.items() if n in named}, shape=shape)


def _of_trial(values: Mapping[str, Any], index: int) -> dict[str, Any]:
    """Return the values of one trial, from numbers and from arrays of shape (trials,)."""

    def own(value: Any) -> Any:
        if isinstance(value, Mapping):
            return _of_trial(value, index)
        if value is None or isinstance(value, SurfaceFigure):
            return value and value.trial(index)
        return float(value[index]) if np.ndim(value) else value

    return {name: own(value) for name, value in values.items()}


def radius_delta_mm(lens: Lens, surface: int, name: str, value: Array) -> Array:
    """Convert a radius tolerance in mm, per cent or fringes to a change of radius in mm.

    Fringes are those of 632.8 nm over the clear semi-diameter. One fringe is half a wave of sag at the edge,
    h^2 dR / (2 R^2). A positive value makes the surface flatter.
    """
    from lensdesign.analysis.form_error import TEST_WAVELENGTH_UM

    if name.endswith("_mm"):
        return value
    nominal = lens.surfaces[surface]
    radius, semi_diameter = getattr(nominal, RADII[name]), nominal.semi_diameter_mm
    assert radius is not None  # guaranteed by PerturbedParameter.check
    if name.endswith("_percent"):
        return 0.01 * radius * value
    assert semi_diameter is not None
    return np.sign(radius) * 1e-3 * TEST_WAVELENGTH_UM * (radius / semi_diameter) ** 2 * value


def abbe_index_delta(lens: Lens, surface: int, wavelength_um: float, percent: Array) -> Array:
    """Return the change of index at a wavelength for a relative error of the Abbe number in per cent.

    The index at the helium d line stays; the dispersion is inversely proportional to the Abbe number.
    """
    d_line_um = 0.5875618
    n_d, n = (lens.indices(w)[surface + 1] for w in (d_line_um, wavelength_um))
    return (n - n_d) * (1.0 / (1.0 + 0.01 * percent) - 1.0)


def batch_of(
    parameters: Sequence[PerturbedParameter],
    values: Array,
    pivot_z_mm: float,
    seed: int,
    trial_numbers: Sequence[int] | None = None,
) -> PerturbationBatch:
    """Return a batch together with the random figures of its irregularities.

    Parameters
    ----------
    parameters : sequence of PerturbedParameter
        Perturbed parameters, one for each column of `values`.
    values : ndarray, shape (trials, parameters)
        Deltas from nominal, in the units of the parameters.
    pivot_z_mm
        Position on the axis about which the whole lens tilts, from its front vertex.
    seed
        Seed of the study. The shape of a figure depends on the seed, the trial's number and the column.
    trial_numbers
        Numbers of the trials; default: all trials have the shapes of trial 0.

    Examples
    --------
    >>> import numpy as np
    >>> decenter = PerturbedParameter(target="lens", parameter="decenter_x_mm")
    >>> batch = batch_of([decenter], np.array([[0.1], [-0.2]]), pivot_z_mm=0.0, seed=1)
    >>> batch.poses().decenter_x_mm
    array([ 0.1, -0.2])
    """
    from tolerancing.perturbations.draws import shape_generator
    from tolerancing.perturbations.irregularity import draw_shape

    trials = [0] * len(values) if trial_numbers is None else trial_numbers
    shapes = {
        column: np.stack([draw_shape(shape_generator(seed, trial, column)) for trial in trials])
        for column, parameter in enumerate(parameters)
        if parameter.parameter in IRREGULARITIES
    }
    return PerturbationBatch(tuple(parameters), values, pivot_z_mm, shapes, tuple(trial_numbers or ()))

"""Realised perturbations: from drawn deltas to the lens, object, sensor and light of each trial."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.lens.figure import SurfaceFigure
from lensdesign.lens.lens import Lens
from lensdesign.lens.poses import SURFACE_DELTAS, Pose, SurfacePerturbation
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
from wavesim.scene.placement import Placement

D_LINE_UM = 0.5875618
"""Of helium, at which catalogues state n_d and the Abbe number."""

ACROSS = ("decenter_x_mm", "decenter_y_mm")


@dataclass(frozen=True, eq=False)
class PerturbationBatch:
    """Realised deltas of several trials.

    Attributes
    ----------
    parameters : tuple of PerturbedParameter
        What the columns of `values` perturb; columns of one and the same parameter add up.
    values : ndarray, shape (trials, parameters)
        Deltas from nominal, in the units of the parameters.
    pivot_z_mm
        Where on the axis the whole lens turns, from its front vertex.
    shapes : mapping of int to ndarray
        By the column of an irregularity: each trial's figure, as :func:`irregularity.draw_shape` draws it,
        shape (trials, terms).
    numbers : tuple of int
        Of the trials; empty where they have none.
    origin : tuple of PerturbationBatch and int, or None
        The batch, and the place in it, that a batch of one trial was taken from.
    """

    parameters: tuple[PerturbedParameter, ...]
    values: Array
    pivot_z_mm: float = 0.0
    shapes: Mapping[int, Array] = field(default_factory=dict)
    numbers: tuple[int, ...] = ()
    origin: tuple[PerturbationBatch, int] | None = None

    def __len__(self) -> int:
        return len(self.values)

    def trial(self, i: int) -> PerturbationBatch:
        """A batch of one of these trials, counted from 0 within the batch."""
        one = slice(i, i + 1)
        shapes = {column: shape[one] for column, shape in self.shapes.items()}
        return PerturbationBatch(
            self.parameters, self.values[one], self.pivot_z_mm, shapes, self.numbers[one], (self, i)
        )

    def part(self, rows: slice) -> PerturbationBatch:
        """A batch of some of these trials, which shares nothing with this one."""
        shapes = {column: shape[rows] for column, shape in self.shapes.items()}
        return replace(self, values=self.values[rows], shapes=shapes, numbers=self.numbers[rows], origin=None)

    def single_trials(self) -> list[PerturbationBatch]:
        """A batch of its own for each of these trials."""
        return [self.trial(i) for i in range(len(self))]

    def poses(self) -> Pose:
        """Poses of the lens, each perturbed value of shape (trials,)."""
        deltas = {name: self._sum("lens", name) for name in LENS_PARAMETERS if self._has("lens", name)}
        return Pose(**deltas, pivot_z_mm=self.pivot_z_mm)

    def surface_perturbations(self, lens: Lens, wavelength_um: float) -> dict[int, SurfacePerturbation]:
        """Perturbations by surface index, each perturbed value of shape (trials,).

        Parameters
        ----------
        lens
            The nominal lens.
        wavelength_um
            The nominal wavelength; a perturbed one shows in the indices.
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
                self._add_figure(deltas.setdefault(surface, {}), lens, surface, column)
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
        """How far the object stands from where it should, shape (trials, 3)."""
        across = [self._sum("object", name) for name in ACROSS]
        away = self._sum("object", "working_distance_mm")
        for column, parameter in self._heated():
            away += heat_shifts_mm(lens, self.values[:, column], parameter.mount_expansion_per_k)[0]
        return np.column_stack([*across, -away])

    def sensor_shift_mm(self, lens: Lens) -> Array:
        """How far the sensor stands from where it should, shape (trials, 3).

        Planes that err by different distances are taken by their mean: the field retrieved from them can
        stand in one place only.
        """
        along = self.plane_distances_mm(lens).mean(axis=1)
        return np.column_stack([*(self._sum("sensor", name) for name in ACROSS), along])

    def plane_distances_mm(self, lens: Lens) -> Array:
        """How much farther each plane is than it should be, shape (trials, planes)."""
        common, planes = self._sum("sensor", "distance_mm"), len(lens.sensor.plane_distances_mm)
        farther = np.column_stack(
            [common + self._sum("sensor", f"plane_distance_{n}_mm") for n in range(1, planes + 1)]
        )
        for column, parameter in self._heated():
            farther += heat_shifts_mm(lens, self.values[:, column], parameter.mount_expansion_per_k)[1]
        return farther

    def sensor_tilt_deg(self) -> Array:
        """Of the sensor about x and y, shape (trials, 2)."""
        return np.column_stack([self._sum("sensor", name) for name in TILTS])

    def wavelength_shift_um(self) -> Array:
        """How much longer the wavelength is than it should be, shape (trials,)."""
        return self._sum("light", "wavelength_um")

    def reconstruction_slices(self) -> Array:
        """Number of slices of the reconstruction, shape (trials,); 0 leaves it to the merit."""
        return self._sum("reconstruction", "slices")

    @property
    def moves_rays(self) -> bool:
        """Whether object or sensor are perturbed."""
        return any(p.target in ("object", "sensor", "environment") for p in self.parameters)

    def placements(self, lens: Lens, wavelength_um: float) -> list[Placement]:
        """The perturbed systems, trial by trial, each with its wavelength."""
        return [one._placement(lens, wavelength_um) for one in self.single_trials()]

    def _placement(self, lens: Lens, wavelength_um: float) -> Placement:
        surfaces = self.surface_perturbations(lens, wavelength_um)
        return Placement(
            pose=Pose(**_first(vars(self.poses()))),
            surface_perturbations={i: SurfacePerturbation(**_first(vars(p))) for i, p in surfaces.items()},
            object_shift_mm=tuple(self.object_shift_mm(lens)[0].tolist()),
            sensor_shift_mm=tuple(self.sensor_shift_mm(lens)[0].tolist()),
            plane_distances_mm=tuple(self.plane_distances_mm(lens)[0].tolist()),
            sensor_tilt_deg=tuple(self.sensor_tilt_deg()[0].tolist()),
            wavelength_um=wavelength_um + float(self.wavelength_shift_um()[0]),
        )

    def _heated(self) -> list[tuple[int, PerturbedParameter]]:
        """Columns of temperatures."""
        return [(k, p) for k, p in enumerate(self.parameters) if p.target == "environment"]

    def _has(self, target: str, name: str) -> bool:
        return any(p.target == target and p.parameter == name for p in self.parameters)

    def _sum(self, target: str, name: str) -> Array:
        chosen = [k for k, p in enumerate(self.parameters) if p.target == target and p.parameter == name]
        return np.ascontiguousarray(self.values[:, chosen].sum(axis=1))

    def _add_figure(self, own: dict[str, Any], lens: Lens, surface: int, column: int) -> None:
        from tolerancing.perturbations.irregularity import random_figures

        semi_diameter = lens.surfaces[surface].semi_diameter_mm
        assert semi_diameter is not None  # the study's check saw to it
        quantity = self.parameters[column].parameter.split("_")[1]
        figure = random_figures(self.shapes[column], self.values[:, column], quantity, semi_diameter)
        if "figure" in own:
            coefficients = own["figure"].coefficients + figure.coefficients
            figure = type(figure)(figure.semi_diameter_mm, figure.spacing_mm, coefficients)
        own["figure"] = figure

    def _dispersion(self, lens: Lens, wavelength_um: float) -> dict[int, Array]:
        """Change of index behind each surface, by surface, that perturbed wavelengths bring."""
        shifts, places = np.unique(self.wavelength_shift_um(), return_inverse=True)
        nominal = lens.indices(wavelength_um)
        changes = np.stack([lens.indices(wavelength_um + shift) - nominal for shift in shifts])[places]
        return {i: changes[:, i + 1] for i in range(len(lens.surfaces)) if np.any(changes[:, i + 1])}


def _perturbed(deltas: Mapping[str, Any]) -> SurfacePerturbation:
    """A surface's perturbation from deltas by the names of parameters."""
    named = vars(SurfacePerturbation())
    shape = {name: delta for name, delta in deltas.items() if name not in named}
    return SurfacePerturbation(**{n: delta for n, delta in deltas.items() if n in named}, shape=shape)


def _first(values: Mapping[str, Any]) -> dict[str, Any]:
    """The values of the first trial."""

    def first(value: Any) -> Any:
        if isinstance(value, Mapping):
            return _first(value)
        if value is None or isinstance(value, SurfaceFigure):
            return value and value.trial(0)
        return float(np.ravel(value)[0])

    return {name: first(value) for name, value in values.items()}


def radius_delta_mm(lens: Lens, surface: int, name: str, value: Array) -> Array:
    """Change of radius for mm, percents, or for fringes of 632.8 nm over the clear semi-diameter.

    One fringe is half a wave of sag at the rim, h^2 dR / (2 R^2); more of either makes a surface flatter.
    """
    from lensdesign.analysis.form_error import TEST_WAVELENGTH_UM

    if name.endswith("_mm"):
        return value
    held = lens.surfaces[surface]
    radius, semi_diameter = getattr(held, RADII[name]), held.semi_diameter_mm
    assert radius is not None  # the study's check saw to it
    if name.endswith("_percent"):
        return 0.01 * radius * value
    assert semi_diameter is not None
    return np.sign(radius) * 1e-3 * TEST_WAVELENGTH_UM * (radius / semi_diameter) ** 2 * value


def abbe_index_delta(lens: Lens, surface: int, wavelength_um: float, percent: Array) -> Array:
    """Change of index at a wavelength if the Abbe number is larger by so many per cent.

    The index at the helium d line stays; its difference from there shrinks as the Abbe number grows.
    """
    at_d, here = (lens.indices(w)[surface + 1] for w in (D_LINE_UM, wavelength_um))
    return (here - at_d) * (1.0 / (1.0 + 0.01 * percent) - 1.0)


def batch_of(
    parameters: Sequence[PerturbedParameter],
    values: Array,
    pivot_z_mm: float,
    seed: int,
    numbers: Sequence[int] | None = None,
) -> PerturbationBatch:
    """A batch with the figures of its irregularities.

    Parameters
    ----------
    parameters, values, pivot_z_mm
        As of :class:`PerturbationBatch`.
    seed
        The study's seed; a figure's shape depends on it, on the trial's number and on the column.
    numbers
        Of the trials; where left out, all have the shapes of trial 0.
    """
    from tolerancing.perturbations.draws import shape_generator
    from tolerancing.perturbations.irregularity import draw_shape

    trials = [0] * len(values) if numbers is None else numbers
    shapes = {
        column: np.stack([draw_shape(shape_generator(seed, trial, column)) for trial in trials])
        for column, parameter in enumerate(parameters)
        if parameter.parameter in IRREGULARITIES
    }
    return PerturbationBatch(tuple(parameters), values, pivot_z_mm, shapes, tuple(numbers or ()))

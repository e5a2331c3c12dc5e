"""First and second derivatives by perturbations of the parameters of a system."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from lensdesign.common.arrays import Array
from lensdesign.lens.lens import Lens
from lensdesign.lens.poses import rotation_matrix
from lensdesign.lens.surface_figure import SurfaceFigure
from lensdesign.raytrace.compiled import compile_system
from tolerancing.perturbations.batch import PerturbationBatch
from tolerancing.perturbations.irregularity import INDICES, peak_to_valley, random_surface_figures
from tolerancing.perturbations.parameters import PerturbedParameter
from tolerancing.prediction.paths import ParameterLayout


@dataclass(frozen=True, eq=False)
class Changes:
    """Derivatives by d changes of the parameters of a system (:class:`ParameterLayout`).

    A perturbation is one change, except that an irregularity has one change for each term of its figures.

    Attributes
    ----------
    layout : ParameterLayout
        Positions of the system parameters.
    first : ndarray, shape (system parameters, d)
        Derivatives of the system's parameters, for a unit of each change.
    second : sparse array, shape (d (d + 1) / 2, system parameters)
        Second derivatives by pairs of changes (i, j), i <= j, in the order of `numpy.triu_indices`.
    columns : tuple of slice
        Changes of each perturbation.
    figures : tuple of (int, slice, SurfaceFigure)
        For each irregularity: index of the surface, changes, and figures for one unit of each change.
    """

    layout: ParameterLayout
    first: Array
    second: sparse.csr_array
    columns: tuple[slice, ...]
    figures: tuple[tuple[int, slice, SurfaceFigure], ...]

    @property
    def count(self) -> int:
        """Number of changes."""
        return self.first.shape[1]


def amounts_of(batch: PerturbationBatch) -> Array:
    """Return the amount of each change in each trial, shape (trials, d)."""
    columns, count = columns_of(batch.parameters)
    found = np.zeros((len(batch), count))
    for k, (own, parameter) in enumerate(zip(columns, batch.parameters, strict=True)):
        if not parameter.is_irregularity:
            found[:, own.start] = batch.values[:, k]
            continue
        shapes = batch.shapes[k]
        size = peak_to_valley(shapes) if parameter.parameter.split("_")[1] == "pv" else 1.0
        found[:, own] = (batch.values[:, k] / size)[:, None] * shapes
    return found


def columns_of(parameters: Sequence[PerturbedParameter]) -> tuple[tuple[slice, ...], int]:
    """Return the changes of each perturbation, and the number of changes."""
    columns, place = [], 0
    for parameter in parameters:
        count = len(INDICES) if parameter.is_irregularity else 1
        columns.append(slice(place, place + count))
        place += count
    return tuple(columns), place


def changes_of(
    lens: Lens,
    parameters: Sequence[PerturbedParameter],
    sizes: Array,
    pivot_z_mm: float,
    wavelength_um: float,
    second: bool = True,
) -> Changes:
    """Return the changes that perturbations of a lens cause.

    Parameters
    ----------
    lens
        The nominal lens.
    parameters
        Perturbed parameters.
    sizes : ndarray, shape (parameters,)
        Approximate sizes; finite differences use a tenth of them.
    pivot_z_mm
        Position on the axis about which the whole lens tilts.
    wavelength_um
        Nominal vacuum wavelength.
    second
        Whether second derivatives are computed; otherwise they are 0.

    Raises
    ------
    InputError
        If the lens does not have a perturbed parameter.
    """
    smooth = [k for k, p in enumerate(parameters) if not p.is_irregularity]
    system_parameters = _SystemParameters(lens, [parameters[k] for k in smooth], pivot_z_mm, wavelength_um)
    # Step of finite differences, as a fraction of a perturbation's size.
    step_fraction = 0.1
    steps = step_fraction * np.asarray(sizes, float)[smooth]
    slopes, (i, j, bends) = system_parameters.derivatives(steps, second)
    columns, place = columns_of(parameters)
    own = np.array([columns[k].start for k in smooth], int)
    first_all = np.zeros((len(slopes), place))
    first_all[:, own] = slopes
    at, number = np.nonzero(bends)
    pairs = pair_places(place, own[i], own[j])[at]
    shape = (place * (place + 1) // 2, len(slopes))
    second_all = sparse.csr_array((bends[at, number], (pairs, number)), shape=shape)
    figures = tuple(
        (surface, columns[k], _unit_surface_figures(lens, surface))
        for k, p in enumerate(parameters)
        if p.is_irregularity and (surface := p.surface) is not None
    )
    return Changes(system_parameters.layout, first_all, second_all, columns, figures)


def pair_places(count: int, i: NDArray[np.intp], j: NDArray[np.intp]) -> NDArray[np.intp]:
    """Return the positions of pairs (i, j), i <= j, in the upper triangle, row by row."""
    return i * (2 * count - i - 1) // 2 + j


def _unit_surface_figures(lens: Lens, surface: int) -> SurfaceFigure:
    """Return figures of one wave root mean square of each polynomial."""
    semi_diameter = lens.surfaces[surface].semi_diameter_mm
    assert semi_diameter is not None  # checked with the study
    ones = np.ones(len(INDICES))
    return random_surface_figures(np.eye(len(INDICES)), ones, "rms", semi_diameter)


class _SystemParameters:
    """The parameters of a perturbed system as a function of d perturbations."""

    def __init__(
        self, lens: Lens, parameters: Sequence[PerturbedParameter], pivot_z_mm: float, wavelength_um: float
    ) -> None:
        self.lens, self.parameters = lens, tuple(parameters)
        self.pivot_z_mm, self.wavelength_um = pivot_z_mm, wavelength_um
        self.layout = ParameterLayout(tuple(s.shape.terms.shape[-1] for s in lens.surfaces))

    def at(self, values: Array) -> Array:
        """Return the system parameters, one row for each trial, for values of shape (trials, d)."""
        lens, layout = self.lens, self.layout
        batch = PerturbationBatch(self.parameters, values, self.pivot_z_mm)
        perturbed = batch.surface_perturbations(lens, self.wavelength_um)
        system = compile_system(lens, self.wavelength_um, batch.poses(), perturbed)
        found = np.zeros((len(values), layout.size))
        for k in range(layout.surfaces):
            pose = found[:, layout.pose(k + 1)]
            pose[:, :9] = system.rotation[:, k].reshape(-1, 9)
            pose[:, 9:] = system.vertex[:, k]
            found[:, layout.of_shape(k)] = system.shapes[k].terms
        found[:, layout.indices] = system.index
        found[:, layout.pose(0)][:, 9:] = batch.object_shift_mm(lens)
        sensor = found[:, layout.pose(layout.surfaces + 1)]
        tilts = np.deg2rad(batch.sensor_tilt_deg())
        sensor[:, :9] = rotation_matrix(tilts[:, 0], tilts[:, 1]).reshape(-1, 9)
        sensor[:, 9:] = batch.sensor_shift_mm(lens)
        shift = batch.wavelength_shift_um()
        found[:, layout.waves] = self.wavelength_um / (self.wavelength_um + shift)
        return found

    def derivatives(
        self, steps: Array, second: bool
    ) -> tuple[Array, tuple[NDArray[np.intp], NDArray[np.intp], Array]]:
        """Return first derivatives, shape (system parameters, d), and second derivatives by pairs i <= j.

        The second derivatives are the indices i and j, and values of shape (pairs, system parameters); those
        of other pairs are 0.
        """
        d, none = len(steps), np.zeros(0, int)
        if d == 0:
            return np.zeros((self.layout.size, 0)), (none, none, np.zeros((0, self.layout.size)))
        ends = self.at(np.concatenate([np.diag(steps), -np.diag(steps), np.zeros((1, d))]))
        high, low, middle = ends[:d], ends[d : 2 * d], ends[-1]
        slopes = ((high - low) / (2.0 * steps[:, None])).T
        if not second:
            return slopes, (none, none, np.zeros((0, self.layout.size)))
        alone = high + low - 2.0 * middle
        # Second differences below this fraction of the first differences are rounding errors.
        rounding = 1e-9
        alone[np.abs(alone) <= rounding * np.abs(high - low)] = 0.0
        i, j = self._pairs(slopes)
        values = np.zeros((d, len(i)))
        values[i, np.arange(len(i))], values[j, np.arange(len(i))] = steps[i], steps[j]
        high -= middle
        crossed = (self.at(values.T) if len(i) else np.zeros((0, self.layout.size))) - middle
        crossed -= high[i]
        crossed -= high[j]
        size = np.abs(high)
        crossed[np.abs(crossed) <= rounding * (size[i] + size[j])] = 0.0
        bends = np.concatenate([alone / steps[:, None] ** 2, crossed / (steps[i] * steps[j])[:, None]])
        return slopes, (np.append(np.arange(d), i), np.append(np.arange(d), j), bends)

    def _pairs(self, slopes: Array) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Return the pairs of perturbations with at least one rotation; other pairs do not interact."""
        layout = self.layout
        turns = np.zeros(slopes.shape[1], bool)
        for k in range(layout.surfaces + 2):
            turns |= np.any(slopes[layout.pose(k)][:9], axis=0)
        i, j = np.triu_indices(slopes.shape[1], 1)
        both = turns[i] | turns[j]
        return i[both], j[both]

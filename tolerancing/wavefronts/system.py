"""What perturbations do to the numbers of a lens: poses, shapes and indices, to first and second order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from lensdesign.lens.figure import SurfaceFigure
from lensdesign.lens.lens import Lens
from lensdesign.lens.poses import rotation_matrix
from lensdesign.tracing.compiled import compile_system
from tolerancing.perturbations.batch import PerturbationBatch
from tolerancing.perturbations.irregularity import INDICES, peak_to_valley, random_figures
from tolerancing.perturbations.parameters import PerturbedParameter
from tolerancing.wavefronts.paths import Layout

STEP_SHARE = 0.1
"""Of a perturbation's size, for differences of the numbers; they bend little over that."""

ROUNDING = 1e-9
"""Second differences below this share of the numbers' first ones are rounding."""


@dataclass(frozen=True, eq=False)
class Changes:
    """What d changes do to a system.

    A perturbation is one change, but an irregularity is as many as its figures have terms.

    Attributes
    ----------
    layout : Layout
    first : ndarray, shape (numbers, d)
        Derivatives of the system's numbers, for a unit of each change.
    second : ndarray, shape (numbers, d, d)
        Second derivatives.
    columns : tuple of slice
        Which changes each perturbation is.
    figures : tuple of (int, slice, SurfaceFigure)
        Of irregularities: surface from 0, changes, and the figures of one unit of each.
    """

    layout: Layout
    first: Array
    second: Array
    columns: tuple[slice, ...]
    figures: tuple[tuple[int, slice, SurfaceFigure], ...]

    @property
    def count(self) -> int:
        """How many changes there are."""
        return self.first.shape[1]

    def amounts(self, batch: PerturbationBatch) -> Array:
        """How much of each change each trial has, shape (trials, d)."""
        found = np.zeros((len(batch), self.count))
        for k, (columns, parameter) in enumerate(zip(self.columns, batch.parameters, strict=True)):
            if not parameter.is_irregularity:
                found[:, columns.start] = batch.values[:, k]
                continue
            shapes = batch.shapes[k]
            size = peak_to_valley(shapes) if parameter.parameter.split("_")[1] == "pv" else 1.0
            found[:, columns] = (batch.values[:, k] / size)[:, None] * shapes
        return found


def changes_of(
    lens: Lens,
    parameters: Sequence[PerturbedParameter],
    sizes: Array,
    pivot_z_mm: float,
    wavelength_um: float,
    second: bool = True,
) -> Changes:
    """Changes that perturbations of a lens are.

    Parameters
    ----------
    lens
        The nominal lens.
    parameters
        What is perturbed.
    sizes : ndarray, shape (parameters,)
        By how much, roughly: differences are taken over a tenth of it.
    pivot_z_mm
        Where on the axis the whole lens turns.
    wavelength_um
        Nominal vacuum wavelength.
    second
        Whether second derivatives are asked for; left at 0 elsewhere.

    Raises
    ------
    InputError
        If a perturbation is none of this lens.
    """
    smooth = [k for k, p in enumerate(parameters) if not p.is_irregularity]
    numbers = _Numbers(lens, [parameters[k] for k in smooth], pivot_z_mm, wavelength_um)
    slopes, bends = numbers.derivatives(STEP_SHARE * np.asarray(sizes, float)[smooth], second)
    columns, place = [], 0
    for parameter in parameters:
        count = len(INDICES) if parameter.is_irregularity else 1
        columns.append(slice(place, place + count))
        place += count
    own = [columns[k].start for k in smooth]
    first_all = np.zeros((len(slopes), place))
    first_all[:, own] = slopes
    second_all = np.zeros((len(slopes), place, place))
    second_all[:, np.array(own, int)[:, None], own] = bends
    figures = tuple(
        (surface, columns[k], _unit_figures(lens, surface))
        for k, p in enumerate(parameters)
        if p.is_irregularity and (surface := p.surface) is not None
    )
    return Changes(numbers.layout, first_all, second_all, tuple(columns), figures)


def _unit_figures(lens: Lens, surface: int) -> SurfaceFigure:
    """Of one wave root mean square of each polynomial."""
    semi_diameter = lens.surfaces[surface].semi_diameter_mm
    assert semi_diameter is not None  # the study's check saw to it
    ones = np.ones(len(INDICES))
    return random_figures(np.eye(len(INDICES)), ones, "rms", semi_diameter)


class _Numbers:
    """The numbers of a perturbed lens as a function of d perturbations."""

    def __init__(
        self, lens: Lens, parameters: Sequence[PerturbedParameter], pivot_z_mm: float, wavelength_um: float
    ) -> None:
        self.lens, self.parameters = lens, tuple(parameters)
        self.pivot_z_mm, self.wavelength_um = pivot_z_mm, wavelength_um
        self.layout = Layout(tuple(s.shape.terms.shape[-1] for s in lens.surfaces))

    def at(self, values: Array) -> Array:
        """Shape (trials, numbers) for values of shape (trials, d)."""
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

    def derivatives(self, steps: Array, second: bool) -> tuple[Array, Array]:
        """First and second derivatives at nominal, shapes (numbers, d) and (numbers, d, d)."""
        d = len(steps)
        if d == 0:
            return np.zeros((self.layout.size, 0)), np.zeros((self.layout.size, 0, 0))
        ends = self.at(np.concatenate([np.diag(steps), -np.diag(steps), np.zeros((1, d))]))
        high, low, middle = ends[:d], ends[d : 2 * d], ends[-1]
        slopes = ((high - low) / (2.0 * steps[:, None])).T
        bends = np.zeros((self.layout.size, d, d))
        if not second:
            return slopes, bends
        alone = high + low - 2.0 * middle
        alone[np.abs(alone) <= ROUNDING * np.abs(high - low)] = 0.0
        bends[:, np.arange(d), np.arange(d)] = (alone / steps[:, None] ** 2).T
        i, j = self._pairs(slopes)
        if len(i):
            values = np.zeros((len(i), d))
            values[np.arange(len(i)), i], values[np.arange(len(i)), j] = steps[i], steps[j]
            crossed = self.at(values) - high[i] - high[j] + middle
            crossed[np.abs(crossed) <= ROUNDING * (np.abs(high[i] - middle) + np.abs(high[j] - middle))] = 0.0
            mixed = (crossed / (steps[i] * steps[j])[:, None]).T
            bends[:, i, j] = bends[:, j, i] = mixed
        return slopes, bends

    def _pairs(self, slopes: Array) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Perturbations that may act on one and the same number together: one of them turns a part."""
        layout = self.layout
        turns = np.zeros(slopes.shape[1], bool)
        for k in range(layout.surfaces + 2):
            turns |= np.any(slopes[layout.pose(k)][:9], axis=0)
        i, j = np.triu_indices(slopes.shape[1], 1)
        both = turns[i] | turns[j]
        return i[both], j[both]

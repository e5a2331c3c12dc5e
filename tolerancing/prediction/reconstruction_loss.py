"""Expected reconstruction loss of lenses as built, without trials.

The merit `reconstruction_loss` (:mod:`tolerancing.merits.reconstruction_loss`) traces rays through each
perturbed lens. Here the change of path on a meridian is linear in the perturbations, by Fermat's principle
along nominal rays (:mod:`tolerancing.prediction.paths`). Everything else is as in the merit
(:mod:`wavesim.pupil.batched_reconstruction`). The compensators of the study are the parameters of a
calibrated reconstruction. A least-squares fit to the visible part of the path changes determines them within
their limits.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError
from lensdesign.lens.lens import Lens
from lensdesign.raytrace.compiled import CompiledSystem, compile_system
from lensdesign.raytrace.rays import trace_compiled
from tolerancing.merits.compensators import regularised
from tolerancing.merits.reconstruction_loss import AZIMUTHS_DEG, ReconstructionLoss
from tolerancing.perturbations.batch import PerturbationBatch
from tolerancing.perturbations.parameters import PerturbedParameter
from tolerancing.prediction.compensation import bounded_least_squares
from tolerancing.prediction.derivatives import first_by, sag_errors_on
from tolerancing.prediction.paths import Paths
from tolerancing.prediction.system import Changes, changes_of, columns_of
from tolerancing.prediction.wavefront_prediction import drawn_amounts
from tolerancing.study.study import Study
from wavesim.pupil import LinearisedReconstruction
from wavesim.pupil.batched_reconstruction import TERMS, BatchedReconstruction, polynomial_terms
from wavesim.pupil.meridian import NODES, PIXELS_PER_SAMPLE

DRAWS = 256
"""Number of drawn lenses that predict the mean loss of a finished lens."""


@dataclass(frozen=True, eq=False)
class LossPaths:
    """Changes of path by d changes of a lens and by k compensators.

    Attributes
    ----------
    lens : ndarray, shape (points, meridians, terms, d)
        Coefficients of the change of path in waves, for a unit of each change of the lens.
    model : ndarray, shape (points, meridians, terms, k)
        The same for each compensator at its limit.
    """

    lens: Array
    model: Array


@dataclass(frozen=True, eq=False)
class LossModel:
    """The linearised reconstructions at a merit's object points.

    Attributes
    ----------
    points : tuple of tuple of BatchedReconstruction
        Reconstruction on each meridian for each object point.
    """

    points: tuple[tuple[BatchedReconstruction, ...], ...]

    def coefficients(self, paths: LossPaths, amounts: Array) -> Array:
        """Return the change of path of each lens that remains after calibration.

        Parameters
        ----------
        paths : LossPaths
        amounts : ndarray, shape (lenses, d)
            Amount of each change in each lens.

        Returns
        -------
        ndarray, shape (points, meridians, lenses, terms)
        """
        found = np.einsum("pmtd,nd->pmnt", paths.lens, amounts, optimize=True)
        if paths.model.shape[-1]:
            for k, reconstructions in enumerate(self.points):
                fractions = _calibrated(reconstructions, paths.lens[k], paths.model[k], amounts)
                found[k] -= np.einsum("mtk,nk->mnt", paths.model[k], fractions)
        return found

    def losses(self, coefficients: Array, derivatives: bool = False) -> tuple[Array, Array]:
        """Return the expected loss at each object point of each lens.

        Parameters
        ----------
        coefficients : ndarray, shape (points, meridians, lenses, terms)
            Coefficients from :meth:`coefficients`.
        derivatives : bool
            Whether derivatives are computed.

        Returns
        -------
        losses : ndarray, shape (points, lenses)
        by : ndarray, shape (points, meridians, lenses, terms)
            Derivatives by the coefficients; zero if `derivatives` is False.
        """
        losses, by = np.empty((len(self.points), coefficients.shape[2])), np.zeros(coefficients.shape)
        for k, reconstructions in enumerate(self.points):
            pairs = [
                one.correlations(own, derivatives)
                for one, own in zip(reconstructions, coefficients[k], strict=True)
            ]
            squares = 1.0 + np.maximum(sum(r**-2 - 1.0 for r, _ in pairs), 0.0)
            losses[k] = 1.0 - squares**-0.5
            for m, (r, slopes) in enumerate(pairs):
                by[k, m] = (-(squares**-1.5) * r**-3)[:, None] * slopes
        return losses, by


def loss_model(lens: Lens, merit: ReconstructionLoss, pixels_per_sample: float | None = None) -> LossModel:
    """Return the linearised reconstructions at a merit's object points.

    Parameters
    ----------
    lens
        The nominal lens.
    merit
        The merit.
    pixels_per_sample
        Pixels of each plane for each sample of the object, for a coarser and faster model. None: the number
        of the merit.

    Raises
    ------
    InputError
        If rays of a line do not pass.
    """

    def reconstructions(point: tuple[float, float]) -> tuple[BatchedReconstruction, ...]:
        own = merit.reconstructions(lens, point)
        if pixels_per_sample is not None:
            own = [_coarser(one, pixels_per_sample) for one in own]
        return tuple(map(BatchedReconstruction, own))

    return LossModel(tuple(map(reconstructions, merit.points)))


def loss_paths(lens: Lens, study: Study, merit: ReconstructionLoss) -> LossPaths:
    """Return the changes of path of a merit, to first order in the perturbations.

    Raises
    ------
    InputError
        If rays of a line do not pass, or the lens does not have a perturbed parameter.
    """
    wavelength = lens.wavelengths_um[0] if merit.wavelength_um is None else merit.wavelength_um
    scatter = [p.tolerance for p in study.perturbations]
    limits = np.array([c.limit for c in study.compensators])
    perturbed = _changed(lens, study.perturbations, scatter, study.pivot_z_mm, wavelength)
    adapted = _changed(lens, study.compensators, limits.tolist(), study.pivot_z_mm, wavelength)
    system, own, model = compile_system(lens, wavelength), [], []
    for point in merit.points:
        nodes = [_Nodes(lens, system, merit, point, azimuth) for azimuth in AZIMUTHS_DEG]
        own.append([one.coefficients(perturbed) for one in nodes])
        model.append([one.coefficients(adapted) * limits for one in nodes])
    return LossPaths(np.array(own), np.array(model))


def expected_losses(lens: Lens, study: Study, merit: ReconstructionLoss, amounts: Array) -> Array:
    """Predict the score of a merit for each lens: the largest loss of the merit's object points.

    The second order of paths in the perturbations is neglected, in addition to the approximations of the
    merit.

    Parameters
    ----------
    lens
        The nominal lens.
    study
        Its perturbations and compensators.
    merit
        The merit.
    amounts : ndarray, shape (lenses, d)
        Amount of each change in each lens (:func:`tolerancing.prediction.system.amounts_of`).

    Returns
    -------
    ndarray, shape (lenses,)

    Raises
    ------
    InputError
        If rays of a line do not pass, or the lens does not have a perturbed parameter.
    """
    model = loss_model(lens, merit)
    losses, _ = model.losses(model.coefficients(loss_paths(lens, study, merit), amounts))
    return np.asarray(losses.max(axis=0))


def mean_loss(lens: Lens, study: Study, merit: ReconstructionLoss) -> float:
    """Predict the mean of a merit over lenses as built.

    The lenses are drawn from the perturbations of the study by a Sobol sequence.

    Parameters
    ----------
    lens, study, merit
        As for :func:`expected_losses`.
    """
    return float(np.mean(expected_losses(lens, study, merit, drawn_amounts(study, DRAWS))))


def calibration_equations(
    reconstructions: Sequence[BatchedReconstruction], lens: Array, model: Array
) -> tuple[Array, Array]:
    """Return the normal equations of compensators that follow the visible path changes of an object point.

    Parameters
    ----------
    reconstructions
        Reconstruction on each meridian.
    lens, model
        Path changes of the point by the changes of the lens and by the compensators (:class:`LossPaths`).

    Returns
    -------
    matrix : ndarray, shape (k, k)
    right_sides : ndarray, shape (k, d)
        Right side for a unit of each change of the lens.
    """
    visible = [one.visible for one in reconstructions]
    matrix = sum(m.T @ v @ m for v, m in zip(visible, model, strict=True))
    right_sides = sum(m.T @ v @ own for v, own, m in zip(visible, lens, model, strict=True))
    return np.asarray(matrix), np.asarray(right_sides)


def _coarser(reconstruction: LinearisedReconstruction, pixels_per_sample: float) -> LinearisedReconstruction:
    """Return the reconstruction with fewer fans and fewer pixels, which receive the same total light."""
    # Nominal rays are traced from nine object points.
    meridian = replace(reconstruction.meridian, fans=9, pixels_per_sample=pixels_per_sample)
    return replace(
        reconstruction,
        meridian=meridian,
        electrons=reconstruction.electrons * PIXELS_PER_SAMPLE / pixels_per_sample,
    )


def _calibrated(
    reconstructions: Sequence[BatchedReconstruction], lens: Array, model: Array, amounts: Array
) -> Array:
    """Return the fitted compensators of each lens as fractions of their limits, shape (lenses, k)."""
    matrix, across = calibration_equations(reconstructions, lens, model)
    return bounded_least_squares(regularised(matrix), amounts @ across.T)[0]


@dataclass(frozen=True, eq=False)
class _Changed:
    """Changes of a lens, and the motion of each plane relative to the mean motion of all planes."""

    changes: Changes
    farther: Array


def _changed(
    lens: Lens,
    parameters: Sequence[PerturbedParameter],
    sizes: Sequence[float],
    pivot_z_mm: float,
    wavelength_um: float,
) -> _Changed:
    changes = changes_of(lens, parameters, np.array(sizes), pivot_z_mm, wavelength_um, False)
    columns, count = columns_of(parameters)
    steps = np.diag(np.array(sizes, float))
    ends = [
        PerturbationBatch(tuple(parameters), sign * steps, pivot_z_mm).plane_distances_mm(lens)
        for sign in (0.5, -0.5)
    ]
    slopes = (ends[0] - ends[1]) / np.array(sizes, float)[:, None]
    farther = np.zeros((slopes.shape[1], count))
    for k, own in enumerate(columns):
        if not parameters[k].is_irregularity:
            farther[:, own.start] = slopes[k] - slopes[k].mean()
    return _Changed(changes, farther)


class _Nodes:
    """Nominal rays of a meridian to each plane, along which changes of path are evaluated."""

    def __init__(
        self,
        lens: Lens,
        system: CompiledSystem,
        merit: ReconstructionLoss,
        point: tuple[float, float],
        azimuth_deg: float,
    ) -> None:
        distances = np.array(merit.planes_mm or lens.sensor.plane_distances_mm)
        self.wavelength_um = lens.wavelengths_um[0] if merit.wavelength_um is None else merit.wavelength_um
        nodes = (np.cos(np.pi * (np.arange(n) + 0.5) / n) for n in NODES)
        x, p = (part.ravel() for part in np.meshgrid(*nodes, indexing="ij"))
        angle = np.deg2rad(azimuth_deg)
        along = np.array([np.cos(angle), np.sin(angle), 0.0])
        origins = np.array([*point, lens.object_z_mm]) + 0.5 * merit.patch_mm * x[:, None] * along
        directions = lens.object.numerical_aperture * p[:, None] * along
        directions[:, 2] = np.sqrt(1.0 - np.sum(directions**2, axis=1))
        plane_z = lens.exit_vertex_z_mm + distances
        # Without clipping, all lenses of a search have the same rays.
        # Paths end in air: a cover glass changes none of their first derivatives.
        in_air = system.without_cover_glass()
        rays = trace_compiled(in_air, origins, directions, float(plane_z[0]), record_hits=True, clip=False)
        assert rays.hits is not None  # record_hits is true
        ok = rays.ok
        if np.count_nonzero(ok) <= TERMS:
            raise InputError(
                f"only {np.count_nonzero(ok)} rays of a line of {merit.patch_mm:g} mm about {point} mm pass "
                f"the lens; its expected loss needs more than {TERMS}"
            )
        heights, behind = rays.hits[ok, :, :2], rays.direction[ok]
        steps = (plane_z - plane_z[0])[:, None, None] * behind / behind[:, 2:]
        lens_parts = system.shapes, system.vertex[0, :, 2], system.index[0], origins[ok], heights
        self.planes = [Paths(*lens_parts, rays.position[ok] + step) for step in steps]
        self.fit = np.linalg.pinv(polynomial_terms(x[ok], p[ok]), rcond=1e-9)

    def coefficients(self, changed: _Changed) -> Array:
        """Return polynomials of the path in waves for a unit of each change, shape (planes * TERMS, d)."""
        changes, found = changed.changes, []
        # Index of a station's axial shift among the parameters of its pose.
        depth = 11
        sensor = changes.layout.pose(changes.layout.surfaces + 1).start + depth
        for number, paths in enumerate(self.planes):
            path = first_by(paths, changes, sag_errors_on(paths, changes))
            # Additional planes have the mean motion of the planes of the design.
            if number < len(changed.farther):
                path = path + np.outer(paths.by_parameters[:, sensor], changed.farther[number])
            found.append(1e3 / self.wavelength_um * self.fit @ (path - path.mean(axis=0)))
        return np.concatenate(found)

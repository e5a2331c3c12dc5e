"""Merits of traced rays: spread angles, footprints, throughput, transmittance, scattered light."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from lensdesign.common.frozen_model import FiniteNumber, Positive
from lensdesign.lens.lens import Lens
from tolerancing.merits.base import Merit, check_field_point, points_text
from tolerancing.merits.context import Context, Points
from tolerancing.merits.sensor_rays import Arrival, shifted_pose
from tolerancing.perturbations.batch import PerturbationBatch

if TYPE_CHECKING:
    from lensdesign.raytrace.bundles import PupilSamples
    from lensdesign.raytrace.compiled import CompiledSystem


class RayMerit(Merit):
    """A merit of the rays from some field points through the whole stop.

    Attributes
    ----------
    field_points_mm
        Object points (x, y). Default: the axis, eight points on the edge of the field, and eight points at
        the height of the largest ray angle of the nominal lens if that is another height.
    """

    field_points_mm: tuple[tuple[FiniteNumber, FiniteNumber], ...] = ()

    levels: ClassVar[tuple[str, ...]] = ("ray",)
    trials_per_chunk: ClassVar[int] = 256

    def check(self, lens: Lens) -> None:
        for point in self.field_points_mm:
            check_field_point(lens, point, "field_points_mm")

    @property
    def location(self) -> str:
        return points_text(self.field_points_mm) if self.field_points_mm else "over the whole field"

    @property
    def details(self) -> tuple[str, ...]:
        return self.location, *super().details

    def points(self, lens: Lens) -> Points:
        """Return the field points at which a lens is evaluated."""
        if self.field_points_mm:
            return self.field_points_mm
        return ((0.0, 0.0), *_ring(lens.half_field_mm))

    def extreme_points(self, context: Context) -> Points:
        """Return the field points, followed by those of the extreme rays of the nominal lens."""
        points, lens = self.points(context.lens), context.lens
        if self.field_points_mm:
            return points
        wavelength = context.wavelength_um(self.wavelength_um)

        def compute() -> Points:
            from lensdesign.analysis.exit_beam import largest_spread_angle

            height = float(np.hypot(*largest_spread_angle(lens, wavelength).field_mm))
            difference = min(height, lens.half_field_mm - height)
            # Field heights that differ by less than this fraction of the half field count as equal.
            same_height = 1e-6
            return points if difference <= same_height * lens.half_field_mm else (*points, *_ring(height))

        return context.cached(("extreme field points", wavelength), compute)

    def stop_samples(self, context: Context, plane_mm: float | None = None) -> PupilSamples:
        """Return the sample points on the stop; extreme rays of the nominal lens have no weight."""
        own = () if plane_mm is None else (plane_mm,)
        planes = tuple(dict.fromkeys((*context.lens.sensor.plane_distances_mm, *own)))
        return context.extreme_samples(self.extreme_points(context), self.wavelength_um, planes)

    def _launched(
        self, context: Context, batch: PerturbationBatch, stop: PupilSamples
    ) -> tuple[CompiledSystem, Array, Array]:
        """Return the perturbed lenses, and origins and directions of rays from the field points."""
        from lensdesign.raytrace.bundles import launch_compiled
        from lensdesign.raytrace.compiled import compile_system

        lens, wavelength = context.lens, context.wavelength_um(self.wavelength_um)
        pose = batch.poses()
        if batch.moves_rays:
            pose = shifted_pose(pose, -batch.object_shift_mm(lens))
        system = compile_system(lens, wavelength, pose, batch.surface_perturbations(lens, wavelength))
        origins, directions = launch_compiled(
            system,
            self.points(lens),
            stop.points,
            lens.object_z_mm,
            lens.stop_index,
            lens.stop_semi_diameter_mm,
        )
        return system, origins, directions

    def rays_of(self, context: Context, batch: PerturbationBatch, plane_mm: float | None = None) -> Arrival:
        """Trace rays to the first sensor plane, shape (trials, field points * stop points, ...)."""
        stop = self.stop_samples(context, plane_mm)
        return context.rays(batch, self.extreme_points(context), self.wavelength_um, stop)


class LargestSpread(RayMerit):
    """Largest angle between the sensor's normal and a ray behind the lens (Eq. 2), of those that arrive."""

    kind_unit: ClassVar[str] = "deg"

    def scores(self, context: Context, batch: PerturbationBatch) -> Array:
        rays = self.rays_of(context, batch)
        sine = np.hypot(rays.direction[..., 0], rays.direction[..., 1])
        return np.rad2deg(np.arcsin(_largest(sine, rays.ok)))


class FootprintRadius(RayMerit):
    """Largest distance from the sensor's centre at which a ray crosses a plane behind the lens.

    Attributes
    ----------
    plane_distance_mm
        Distance of the plane from the nominal exit vertex; default: the last sensor plane. The plane moves
        and tilts with the sensor.
    """

    plane_distance_mm: Positive | None = None

    kind_unit: ClassVar[str] = "mm"

    @property
    def details(self) -> tuple[str, ...]:
        plane = "the last sensor plane"
        if self.plane_distance_mm is not None:
            plane = f"{self.plane_distance_mm:g} mm behind the exit vertex"
        return plane, *super().details

    def scores(self, context: Context, batch: PerturbationBatch) -> Array:
        lens = context.lens
        distance = self.plane_distance_mm or lens.sensor.plane_distances_mm[-1]
        rays = self.rays_of(context, batch, distance)
        further = distance - lens.sensor.plane_distances_mm[0]
        along = np.where(rays.ok, rays.direction[..., 2], 1.0)
        across = rays.position_mm + further * rays.direction[..., :2] / along[..., None]
        return _largest(np.hypot(across[..., 0], across[..., 1]), rays.ok)


class Throughput(RayMerit):
    """Fraction of the light through the stop that reaches the sensor, with equal weights for field points."""

    def scores(self, context: Context, batch: PerturbationBatch) -> Array:
        rays, weighted = self.rays_of(context, batch), len(self.points(context.lens))
        stop = self.stop_samples(context)
        weights = np.zeros(rays.ok.shape[-1])
        weights[: weighted * len(stop.points)] = np.tile(stop.weights / weighted, weighted)
        return np.sum(np.where(rays.ok, weights, 0.0), axis=-1)


class Transmittance(RayMerit):
    """Mean transmittance of the coatings for unpolarized light, over field points and stop.

    The mean is over the rays that pass the lens; `throughput` counts the others.
    """

    def check(self, lens: Lens) -> None:
        super().check(lens)
        if all(surface.coating == "ideal" for surface in lens.surfaces):
            raise ValueError(
                f"kind = {self.kind!r}: all coatings of the design are ideal and transmit all light; add "
                'coating = "bare", "mgf2" or layers to a surface'
            )

    def scores(self, context: Context, batch: PerturbationBatch) -> Array:
        from lensdesign.raytrace.polarization import jones_matrices
        from lensdesign.raytrace.rays import trace_compiled

        points, stop = self.points(context.lens), context.stop_samples()
        system, origins, directions = self._launched(context, batch, stop)
        rays = trace_compiled(system, origins, directions, record_hits=True)
        transmittance = jones_matrices(system, origins, rays).transmittance
        weights = np.tile(stop.weights, len(points)) * rays.ok
        with np.errstate(invalid="ignore", divide="ignore"):
            means = np.sum(np.where(weights > 0.0, weights * transmittance, 0.0), axis=-1)
            means = means / np.sum(weights, axis=-1)
        return np.broadcast_to(means, (len(batch),)).copy()


class ScatteredFraction(RayMerit):
    """Fraction of the light of a field point that rough surfaces scatter, at the worst field point."""

    def check(self, lens: Lens) -> None:
        super().check(lens)
        if all(surface.roughness is None for surface in lens.surfaces):
            raise ValueError(
                f"kind = {self.kind!r}: no surface of the design has a roughness; add roughness = "
                "{ rms_nm = ..., correlation_length_um = ... } to a surface"
            )

    def scores(self, context: Context, batch: PerturbationBatch) -> Array:
        from lensdesign.analysis.roughness import refractions, roughness_phases_rad, scattered_fraction

        lens, wavelength = context.lens, context.wavelength_um(self.wavelength_um)
        points, stop = self.points(lens), context.stop_samples()
        system, origins, directions = self._launched(context, batch, stop)
        perturbed = batch.surface_perturbations(lens, wavelength)
        rays = refractions(system, origins, directions)
        phases = roughness_phases_rad(lens, rays, wavelength, perturbed)
        fractions = scattered_fraction(np.linalg.norm(phases, axis=-1))
        shape = (-1, len(points), len(stop.points))
        weights = stop.weights * rays.ok.reshape(shape)
        with np.errstate(invalid="ignore", divide="ignore"):
            means = np.sum(weights * fractions.reshape(shape), axis=-1) / np.sum(weights, axis=-1)
        # A field point without light has no scattered light.
        worst = _largest(means, np.isfinite(means))
        return np.broadcast_to(worst, (len(batch),)).copy()


def _largest(values: Array, ok: NDArray[np.bool_]) -> Array:
    """Return the largest value of the rays that arrived, for each trial; NaN if none arrived."""
    largest = np.max(np.where(ok, values, -np.inf), axis=-1)
    return np.where(np.isfinite(largest), largest, np.nan)


def _ring(height_mm: float) -> Points:
    """Return eight field points at one height."""
    angles = np.arange(8) * np.pi / 4.0
    return tuple((float(height_mm * np.cos(a)), float(height_mm * np.sin(a))) for a in angles)

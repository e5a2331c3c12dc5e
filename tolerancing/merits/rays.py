"""Merits of traced rays: spread angles, footprints, throughput."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import field_validator

from lensdesign.common.arrays import Array
from lensdesign.common.section import Finite, Positive, rows
from lensdesign.lens.lens import Lens
from tolerancing.merits.base import Merit, check_field_point, points_text
from tolerancing.merits.context import Context, Points
from tolerancing.perturbations.batch import PerturbationBatch


class RayMerit(Merit):
    """A merit of the rays from some field points through the whole stop.

    Attributes
    ----------
    field_points_mm
        Object points (x, y). Where left out: the axis, and eight points on the rim of the field.
    """

    field_points_mm: tuple[tuple[Finite, Finite], ...] = ()

    levels: ClassVar[tuple[str, ...]] = ("ray",)
    trials_per_chunk: ClassVar[int] = 256

    _lists = field_validator("field_points_mm", mode="before")(rows)

    def check(self, lens: Lens) -> None:
        for point in self.field_points_mm:
            check_field_point(lens, point, "field_points_mm")

    @property
    def details(self) -> tuple[str, ...]:
        if self.field_points_mm:
            return points_text(self.field_points_mm), *super().details
        return "on the axis and at eight points on the rim of the field", *super().details

    def points(self, lens: Lens) -> Points:
        """The field points of this lens."""
        if self.field_points_mm:
            return self.field_points_mm
        angles = np.arange(8) * np.pi / 4.0
        rim = [(float(lens.half_field_mm * np.cos(a)), float(lens.half_field_mm * np.sin(a))) for a in angles]
        return ((0.0, 0.0), *rim)


class LargestSpread(RayMerit):
    """Largest angle between the sensor's normal and a ray behind the lens (Eq. 2), of those that arrive."""

    kind_unit: ClassVar[str] = "deg"

    def scores(self, context: Context, batch: PerturbationBatch) -> Array:
        rays = context.rays(batch, self.points(context.lens), self.wavelength_um)
        sine = np.hypot(rays.direction[..., 0], rays.direction[..., 1])
        return np.rad2deg(np.arcsin(_largest(sine, rays.ok)))


class FootprintRadius(RayMerit):
    """Largest distance from the sensor's centre at which a ray crosses a plane behind the lens.

    Attributes
    ----------
    plane_distance_mm
        The plane, from the nominal exit vertex; the last sensor plane where left out. It moves and tilts
        with the sensor.
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
        rays = context.rays(batch, self.points(lens), self.wavelength_um)
        distance = self.plane_distance_mm or lens.sensor.plane_distances_mm[-1]
        further = distance - lens.sensor.plane_distances_mm[0]
        along = np.where(rays.ok, rays.direction[..., 2], 1.0)
        across = rays.position_mm + further * rays.direction[..., :2] / along[..., None]
        return _largest(np.hypot(across[..., 0], across[..., 1]), rays.ok)


class Throughput(RayMerit):
    """Share of the light through the stop that arrives, all field points weighing the same."""

    def scores(self, context: Context, batch: PerturbationBatch) -> Array:
        points = self.points(context.lens)
        rays = context.rays(batch, points, self.wavelength_um)
        weights = np.tile(context.stop_samples().weights / len(points), len(points))
        return np.sum(np.where(rays.ok, weights, 0.0), axis=-1)


def _largest(values: Array, ok: NDArray[np.bool_]) -> Array:
    """Largest value of the rays that arrived, by trial; NaN where none did."""
    largest = np.max(np.where(ok, values, -np.inf), axis=-1)
    return np.where(np.isfinite(largest), largest, np.nan)

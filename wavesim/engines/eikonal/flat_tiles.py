"""The field of one tile of the object on a plane behind the lens, and its adjoint.

A nonuniform Fourier transform evaluates the tile's spectrum at the directions of its centre's rays. Without
its carrier a exp(i k V), the field has a bandwidth that is proportional to the tile's width. On a plane it is
computed on a coarse grid and interpolated, if this grid has fewer samples.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from wavesim.engines.eikonal.plan import Tile, coarse_step_mm
from wavesim.engines.eikonal.residual import Separable
from wavesim.fields.plane_waves import phasor_of
from wavesim.fields.resampling import (
    Kernel,
    Weights,
    add_interpolated,
    coarse_axis,
    gathered,
    interpolation,
    kernel_for,
)
from wavesim.rays.maps import RayMap, SmoothMap
from wavesim.rays.ray_bundles import RayBundle
from wavesim.runtime.fourier.nonuniform import (
    Precision,
    adjoint_of_terms,
    folded,
    plan_of_terms,
    sum_of_terms,
)
from wavesim.runtime.threads import THREADS, at_once
from wavesim.scene.scene import Scene

GROUP = 4 * THREADS
"""Tiles whose fields are computed before they are added, since threads wait between groups."""


def precision_for(dtype: np.dtype[Any], error: float) -> Precision:
    """Return a precision well below the allowed error, and not finer than the data type."""
    single = dtype == np.complex64
    transform = float(np.clip(4e-2 * error, 1e-5, 2e-3)) if single else 1e-12
    return Precision(dtype, transform, max(4e-2 * error, 1e-7))


def type_of(component: int | None, dtype: np.dtype[Any]) -> np.dtype[Any]:
    """Return the data type of a component on the plane.

    Single precision is enough for crossed components, which have a few percent of the amplitude.
    """
    return np.dtype(np.complex64) if is_crossed(component) else dtype


def is_crossed(component: int | None) -> bool:
    """Return whether a component is crossed to the polarization of the light."""
    return component is not None and component % 2 == 1


def coarse_steps_mm(bundle: RayBundle, spans_mm: Array, wavenumber_per_mm: float) -> Array:
    """Return the sample spacings for a tile's field without its carrier, in the order (y, x)."""
    ok = bundle.ok
    slopes = np.abs(bundle.cosine_jacobian[ok] @ np.linalg.inv(bundle.jacobian[ok]))
    reach = np.max(np.abs(spans_mm), axis=1)
    band = wavenumber_per_mm * np.max(np.einsum("i,nij->nj", reach, slopes), axis=0)
    # Largest step of a coarse grid as a fraction of the footprint's width. Its samples extend beyond the
    # border, where no rays support the maps.
    coarsest = 1.0 / 300.0
    widest = coarsest * np.ptp(bundle.sensor_mm[ok], axis=0)
    return np.minimum(coarse_step_mm(band), widest)


def coarse_is_used(steps_mm: Array, axes: tuple[Array, ...]) -> bool:
    """Return whether a tile's field is computed on a coarse grid instead of the samples themselves."""
    if len(axes) == 1 or min(len(axis) for axis in axes) < 2:
        return False
    # Least ratio of the coarse to the fine pitch for which a coarse grid is used.
    least_ratio = 1.5
    return bool(steps_mm.min() > least_ratio * (axes[0][1] - axes[0][0]))


class TileOperator:
    """The propagation of one tile to a plane.

    Parameters
    ----------
    scene
        Lens and wavelength.
    tile
        Part of the object.
    carrier, factors
        Ray map of the tile's centre, and expansion of the residual beyond the Fourier transform.
    axes
        Samples y (and x) of the plane.
    spans
        Samples that the tile's light reaches: first and end of each row.
    precision
        Precision of transform and interpolation.
    threads
        Threads of one transform.
    """

    def __init__(
        self,
        scene: Scene,
        tile: Tile,
        carrier: RayMap,
        factors: Separable,
        axes: tuple[Array, ...],
        spans: NDArray[np.intp],
        precision: Precision,
        threads: int = 1,
    ) -> None:
        self.part = tile.part
        self._dtype = precision.dtype
        rows = np.nonzero(spans[:, 1] > spans[:, 0])[0] if len(axes) == 2 else np.array([0])
        self.window: tuple[slice, ...] = tuple(slice(0, 0) for _ in axes)
        self._plans: tuple[Any, Any] | None = None
        if not np.any(spans[:, 1] > spans[:, 0]):
            return
        lit = spans[rows[0] : rows[-1] + 1]
        full = lit[:, 1] > lit[:, 0]
        across = slice(int(lit[full, 0].min()), int(lit[full, 1].max()))
        self.window = (slice(int(rows[0]), int(rows[-1]) + 1), across) if len(axes) == 2 else (across,)
        self._fine = fine = tuple(axis[part] for axis, part in zip(axes, self.window, strict=True))
        self._tile_factors = np.ascontiguousarray(factors.tile_factors(list(tile.offsets_mm)), self._dtype)
        k = scene.wavenumber_per_mm
        limit = np.pi / (k * tile.pitch_mm)
        width = tile.width_mm
        carrier_values = _carrier(carrier, fine, lit - across.start, k, limit, width, self._dtype)
        if not np.any(carrier_values):
            return
        steps = coarse_steps_mm(carrier.bundle, tile.spans_mm, k)
        self._interpolation: tuple[Weights, Weights] | None = None
        self._carrier: NDArray = carrier_values
        if coarse_is_used(steps, axes):
            kernel = kernel_for(precision.interpolation_error)
            coarse = tuple(coarse_axis(a, h, kernel) for a, h in zip(fine, steps, strict=True))
            self._prepare_coarse(fine, coarse, kernel, carrier_values)
        else:
            coarse = fine
            self._needed = carrier_values != 0.0
        self._coarse, self._per_cosine, self._precision = coarse, k * tile.pitch_mm, precision
        self._threads = threads
        sensor = None
        if factors.sensor_factors is not None:
            if len(coarse) == 2:
                sensor = self._on_points(factors.sensor_factors)
            else:
                sensor = factors.sensor_factors.at(coarse[0][self._needed, None])
        if sensor is None:
            sensor = np.ones((1, np.count_nonzero(self._needed)))
        if self._interpolation is None:
            sensor = carrier_values[self._needed] * sensor
        self._weights = sensor.astype(self._dtype)
        self._jones: NDArray | None = None
        self._crossed: tuple[tuple[Weights, Weights], NDArray] | None = None
        if carrier.jones is not None:
            self._jones = self._on_points(carrier.jones).astype(self._dtype)
            if self._interpolation is not None:
                self._crossed = self._crossed_interpolation()
        self._set_points(self._on_points(carrier.maps)[2:])

    @property
    def _origin(self) -> tuple[int, int]:
        """Row and column of the plane at which the tile's window begins."""
        return self.window[0].start, self.window[-1].start

    def perturbed(
        self, carrier: RayMap, changes: SmoothMap, wavenumber_per_mm: float, factor: float = 1.0
    ) -> TileOperator:
        """Return the operator of the tile behind a slightly different lens.

        Paths and directions change; amplitudes and the residual expansion do not.

        Parameters
        ----------
        carrier
            Ray map of the tile's centre from which this operator was made.
        changes
            Changes of path and object-side cosines, in the order of its maps.
        wavenumber_per_mm
            Vacuum wavenumber.
        factor
            Factor of the field.
        """
        if self._plans is None:
            return self
        result, change = copy(self), self._on_points(changes)
        fine = changes.along(self._fine).each() if self._interpolation is not None else iter([change[0]])
        twiddle = (factor * np.exp(1j * wavenumber_per_mm * next(iter(fine)))).astype(self._dtype)
        if self._interpolation is not None:
            result._carrier = self._carrier * twiddle
            if self._crossed is not None:
                weights, crossed_carrier = self._crossed
                result._crossed = weights, crossed_carrier * twiddle
        else:
            result._weights = self._weights * twiddle
        result._set_points(self._on_points(carrier.maps)[2:] + change[1:])
        return result

    def _on_points(self, maps: SmoothMap) -> Array:
        """Return the values of maps at the points of the transform, shape (functions, points)."""
        return np.stack([values[self._needed] for values in maps.along(self._coarse).each()])

    def _set_points(self, cosines: Array) -> None:
        shape = self._tile_factors.shape
        self._plans = _plans(cosines * self._per_cosine, shape, self._precision, self._threads)

    def _prepare_coarse(
        self, fine: tuple[Array, ...], coarse: tuple[Array, ...], kernel: Kernel, carrier: NDArray
    ) -> None:
        along_y, along_x = (interpolation(c, f, kernel) for c, f in zip(coarse, fine, strict=True))
        touched = [replace(w, weight=(w.weight != 0.0).astype(np.float32)) for w in (along_y, along_x)]
        lit = (carrier != 0.0).astype(np.complex64)
        self._needed = gathered(lit, (touched[0], touched[1]), lit, threads=1).real > 0.0
        real = np.float32 if self._dtype == np.complex64 else np.float64
        self._interpolation = along_y.astype(real), along_x.astype(real)

    def transformed(self, values: NDArray) -> NDArray | None:
        """Return the tile's field from its transform, for values on its part; None where it is dark."""
        if self._plans is None:
            return None
        field = np.zeros(self._needed.shape, self._dtype)
        field[self._needed] = sum_of_terms(self._plans[0], values, self._tile_factors, self._weights)
        return field

    def add(self, field: NDArray | None, result: NDArray, component: int | None = None) -> None:
        """Add the result of :meth:`transformed`, or one of its components, to the field on the plane."""
        if field is None:
            return
        if component is not None:
            assert self._jones is not None
            scalar, field = field, np.zeros(field.shape, result.dtype)
            field[self._needed] = scalar[self._needed] * self._jones[component]
        if self._interpolation is None:
            result[self.window] += field
        else:
            weights, carrier = self._interpolation_of(component)
            add_interpolated(field, weights, carrier, result, self._origin)

    def _interpolation_of(self, component: int | None) -> tuple[tuple[Weights, Weights], NDArray]:
        """Return the interpolation weights and the carrier for a component of the field."""
        if self._crossed is not None and is_crossed(component):
            return self._crossed
        assert self._interpolation is not None
        return self._interpolation, self._carrier

    def _crossed_interpolation(self) -> tuple[tuple[Weights, Weights], NDArray]:
        """Return weights and carrier for crossed components, whose small size allows larger errors."""
        assert self._jones is not None
        sizes = [float(np.sqrt(np.mean(np.abs(values) ** 2))) for values in self._jones]
        size = max(max(sizes[1::2]) / max(sizes), 1e-6)
        kernel = kernel_for(self._precision.interpolation_error / size, 0.03)
        along_y, along_x = (
            interpolation(c, f, kernel).astype(np.float32)
            for c, f in zip(self._coarse, self._fine, strict=True)
        )
        return (along_y, along_x), self._carrier.astype(np.complex64)

    def adjoint(
        self, planes: Sequence[NDArray], components: Sequence[int | None], threads: int = 1
    ) -> NDArray:
        """Apply the conjugate transpose of :meth:`transformed` and :meth:`add` to fields on the plane."""
        if self._plans is None:
            return np.zeros((), self._dtype)
        strength: Any = 0
        for values, component in zip(planes, components, strict=True):
            if self._interpolation is None:
                field = values[self.window]
            else:
                weights, carrier = self._interpolation_of(component)
                field = gathered(values, weights, carrier, self._origin, threads)
            own = field[self._needed].astype(self._dtype, copy=False)
            if component is not None:
                assert self._jones is not None
                own = own * self._jones[component].conj()
            strength = strength + own if len(planes) > 1 else own
        return np.asarray(adjoint_of_terms(self._plans[1], strength, self._tile_factors, self._weights))


def add_tiles(
    operators: Sequence[TileOperator],
    values: NDArray,
    results: Sequence[NDArray],
    components: Sequence[int | None] = (None,),
) -> None:
    """Add the fields of all tiles of the object to the fields on the plane, one for each component."""
    for start in range(0, len(operators), GROUP):
        some = operators[start : start + GROUP]
        fields = at_once([partial(one.transformed, values[one.part]) for one in some])
        for operator, field in zip(some, fields, strict=True):
            for component, result in zip(components, results, strict=True):
                operator.add(field, result, component)


def add_tiles_adjoint(
    operators: Sequence[TileOperator],
    planes: Sequence[NDArray],
    result: NDArray,
    components: Sequence[int | None] = (None,),
) -> None:
    """Apply the conjugate transpose of :func:`add_tiles`; add the result to the field on the object."""
    for start in range(0, len(operators), GROUP):
        some = operators[start : start + GROUP]
        threads = max(1, THREADS // len(some))
        parts = at_once([partial(one.adjoint, planes, components, threads) for one in some])
        for operator, part in zip(some, parts, strict=True):
            result[operator.part] += part


def _plans(angles: Array, shape: tuple[int, ...], precision: Precision, threads: int) -> tuple[Any, Any]:
    """Return transforms of types 2 and 1 that are each other's conjugate transpose."""
    points = folded(angles, precision.dtype)
    # Least points for each thread of a transform. With fewer points, threads wait longer than they work.
    points_per_thread = 2**16
    most = min(threads, max(1, shape[0] * angles.shape[1] // points_per_thread))
    first, second = (plan_of_terms(kind, shape, precision, most) for kind in (2, 1))
    for plan in (first, second):
        plan.setpts(*points)
    return first, second


def _carrier(
    carrier: RayMap,
    axes: tuple[Array, ...],
    spans: NDArray[np.intp],
    wavenumber_per_mm: float,
    limit: float,
    width_mm: float,
    dtype: np.dtype[Any],
) -> NDArray:
    """Return a exp(i k V) with the constant phase of the propagator, 0 outside the footprint and the object's
    band.

    The result has the shape of the axes; `limit` is the largest cosine that the object grid samples.
    """
    wavelength_mm = 2.0 * np.pi / wavenumber_per_mm
    constant_phase = -0.25 * np.pi * len(axes) - 0.5 * np.pi * carrier.caustics
    scale = wavelength_mm ** (-0.5 * len(axes))
    # If all rays are below this fraction of the grid's largest cosine, single samples are not checked.
    within_band = 0.99
    is_within = np.abs(carrier.bundle.cosines[carrier.bundle.ok]).max() < within_band * limit
    maps = (
        carrier.maps if not is_within else replace(carrier.maps, coefficients=carrier.maps.coefficients[:2])
    )
    result = np.zeros(tuple(len(a) for a in axes), dtype)
    # Samples of a carrier that are computed at a time.
    samples_at_once = 2**18
    rows_at_once = max(1, samples_at_once // len(axes[1])) if len(axes) == 2 else len(axes[0])
    columns = np.arange(len(axes[-1]))
    for start in range(0, len(axes[0]), rows_at_once):
        rows = slice(start, start + rows_at_once)
        here = (axes[0][rows], *axes[1:])
        path, amplitude, *cosines = maps.along(here).each()
        inside = np.ones(path.shape, bool)
        if len(axes) == 2:
            inside = (columns >= spans[rows, :1]) & (columns < spans[rows, 1:])
        for cosine in cosines:
            inside &= np.abs(cosine) <= limit
        path *= wavenumber_per_mm
        path += constant_phase
        amplitude *= scale
        part = result[rows]
        np.multiply(phasor_of(path, dtype), amplitude, out=part, where=inside, casting="same_kind")
        if carrier.edge is not None and carrier.stop is not None:
            stop = np.stack([values[inside] for values in carrier.stop.along(here).each()], axis=-1)
            part[inside] *= carrier.edge.factor(stop, width_mm, carrier.traced)
    return result

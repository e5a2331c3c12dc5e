"""The lens as a thin lens: a quadratic phase of its focal length between two sections of free space.

This is the model of the paper's Fig. 5f. Free space extends from the object to the front principal plane, and
from the rear principal plane to the exit grid, so that first-order imaging is that of the thick lens. The
stop is the disc in which the cone of rays through the real stop, from the axial object point, intersects the
principal plane. On the axis the optical path and the transmission of the coatings are those of the thick
lens.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from lensdesign.analysis.form_error import pv_rms_waves
from lensdesign.analysis.paraxial import cardinal_points
from lensdesign.common.arrays import Array
from lensdesign.errors import InputError, SamplingError, validate_positive
from lensdesign.lens.surface_figure_source import TEST_WAVELENGTH_UM
from lensdesign.raytrace.bundles import launch_compiled, pupil_fan
from lensdesign.raytrace.compiled import compile_system
from lensdesign.raytrace.rays import trace_compiled
from wavesim.engines.surfaces.grids import check_grid_size
from wavesim.fields.field import Grid
from wavesim.fields.propagator import FreeSpacePropagator
from wavesim.rays.interfaces import transmission
from wavesim.runtime.speed import exponential_seconds, pass_seconds
from wavesim.scene.engine import Cost, Engine, ErrorTerm
from wavesim.scene.scene import Scene

FINENESS, WINDOW_MARGIN = 0.9, 1.02
"""Pitch, as a fraction of the coarsest that samples the field; window, as a multiple of the stop."""

FAN_RAYS = 401


@dataclass(frozen=True)
class _ThinLens:
    """First-order properties in the fixed frame.

    Attributes
    ----------
    power_per_mm
        The phase of the lens is the vacuum wavenumber times this times r^2 / 2.
    front_mm, rear_mm
        Principal points (x, y, z).
    semi_diameter_mm
        Semi-diameter of the stop in the principal plane.
    extra_path_mm
        Optical path on the axis between the principal planes.
    """

    power_per_mm: float
    front_mm: Array
    rear_mm: Array
    semi_diameter_mm: float
    extra_path_mm: float


def _thin_lens(scene: Scene) -> _ThinLens:
    system = scene.system
    vertex, index = system.vertex[0], system.index[0]
    thickness = np.linalg.norm(np.diff(vertex, axis=0), axis=-1)
    if not all(shape.ROTATIONAL for shape in system.shapes):
        raise InputError("engine thin-lens: the lens has surfaces that are not rotationally symmetric")
    points = cardinal_points([shape.curvature for shape in system.shapes], thickness, index)
    if not math.isfinite(points.efl_mm):
        raise InputError("engine thin-lens: the lens is afocal and has no principal planes")
    axis = system.rotation[0, 0, :, 2]
    front = vertex[0] + points.front_principal_z_mm * axis
    rear = vertex[0] + points.rear_principal_z_mm * axis
    if front[2] <= scene.object_grid.z_mm:
        raise InputError(f"the front principal plane, z = {front[2]:g} mm, lies in front of the object grid")
    path = float(index[1:-1] @ thickness) - index[0] * points.front_principal_z_mm
    path += index[-1] * (points.rear_principal_z_mm - float(np.sum(thickness)))
    semi = _cone_tangent(scene) * (points.front_principal_z_mm - scene.object_grid.z_mm)
    return _ThinLens(points.power_per_mm, front, rear, semi, float(path))


def _cone_tangent(scene: Scene) -> float:
    """Return the tangent of the marginal ray's angle in the nominal lens."""
    lens = scene.lens
    nominal = compile_system(lens, scene.wavelength_um)
    _, heading = launch_compiled(
        nominal,
        [(0.0, 0.0)],
        [(0.0, 1.0)],
        scene.object_grid.z_mm,
        lens.stop_index,
        lens.stop_semi_diameter_mm,
    )
    return float(heading[0, 1] / heading[0, 2])


class ThinLens(Engine):
    """Thin lens in the principal planes.

    Parameters
    ----------
    scene
        Lens, grids and wavelength. The principal points move with a displaced or tilted lens. Of perturbed
        surfaces only radius, thickness and index count; their poses and figures have no effect.
    pitch_mm
        Pitch in the principal planes. Default: by the steepest light.
    force
        Whether to run even above the limits of memory and time.

    Raises
    ------
    InputError
        If a setting is not usable.
    """

    name = "thin-lens"

    def __init__(self, scene: Scene, *, pitch_mm: float | None = None, force: bool = False) -> None:
        super().__init__(scene)
        if pitch_mm is not None:
            validate_positive("pitch_mm", pitch_mm)
        self._pitch_mm, self._force = pitch_mm, force

    @cached_property
    def thin(self) -> _ThinLens:
        """First-order properties of the lens."""
        return _thin_lens(self.scene)

    @cached_property
    def lens_grids(self) -> tuple[Grid, Grid]:
        """The same samples in the front and in the rear principal plane.

        Raises
        ------
        SamplingError
            If the given pitch cannot sample the light.
        """
        thin, coarsest = self.thin, math.pi / self._steepest_per_mm()
        pitch = FINENESS * coarsest if self._pitch_mm is None else self._pitch_mm
        if pitch > coarsest:
            raise SamplingError(
                f"pitch_mm = {pitch:.4g} in the principal planes: too coarse for the steepest light; "
                f"must be at most {coarsest:.4g} mm"
            )
        count = scipy.fft.next_fast_len(math.ceil(2.0 * WINDOW_MARGIN * thin.semi_diameter_mm / pitch))
        shape = (count,) * len(self.scene.object_grid.shape)
        x_count = 0.0 if self.scene.object_grid.is_line else 1.0
        front, rear = (
            Grid(shape, pitch, float(p[2]), (float(x_count * p[0]), float(p[1])))
            for p in (thin.front_mm, thin.rear_mm)
        )
        return front, rear

    def _steepest_per_mm(self) -> float:
        """Return the largest transverse wavenumber on either side, over all object and stop points."""
        thin, grid = self.thin, self.scene.object_grid
        k, (before, behind) = self.scene.wavenumber_per_mm, self.scene.system.index[0, [0, -1]]
        offset = np.hypot(*(np.array(grid.centre_mm) - thin.front_mm[:2]))
        far = np.array([-1.0, 1.0]) * (offset + math.hypot(*grid.half_widths_mm))
        stop = np.array([-1.0, 1.0])[:, None] * thin.semi_diameter_mm
        lean = stop - far
        into = before * lean / np.hypot(lean, thin.front_mm[2] - grid.z_mm)
        out = np.clip(into - thin.power_per_mm * stop, -behind, behind)
        return float(k * max(np.max(np.abs(into)), np.max(np.abs(out))))

    def _phase(self) -> NDArray[np.complex128]:
        """Return the complex transmission of the lens, with stop and optical path."""
        grid, thin = self.lens_grids[0], self.thin
        (x, y), k = grid.centre_mm, self.scene.wavenumber_per_mm
        r2 = (grid.y_mm - y) ** 2
        if not grid.is_line:
            r2 = r2[:, None] + (grid.x_mm - x) ** 2
        path = np.mod(k * (thin.extra_path_mm - 0.5 * thin.power_per_mm * r2), 2.0 * np.pi)
        passed = self._axial_transmission()
        return np.asarray(np.where(r2 <= thin.semi_diameter_mm**2, passed * np.exp(1j * path), 0.0))

    def _axial_transmission(self) -> complex:
        """Return the transmission of the field along the axis, of all surfaces together."""
        scene, along = self.scene, np.ones(1)
        factors = [transmission(scene, surface, along, along)[0] for surface in range(scene.system.surfaces)]
        return complex(np.prod(factors))

    @cached_property
    def _transfers(self) -> tuple[FreeSpacePropagator, FreeSpacePropagator]:
        """Free space from the object to the front principal plane, and from the rear one to the exit."""
        scene, (front, rear) = self.scene, self.lens_grids
        before, behind = (float(n) for n in scene.system.index[0, [0, -1]])
        return (
            FreeSpacePropagator(scene.object_grid, front, scene.wavelength_um, before),
            FreeSpacePropagator(
                rear, scene.exit_grid, scene.wavelength_um, behind, plate=scene.system.cover_glass
            ),
        )

    @cached_property
    def _prepared(self) -> tuple[FreeSpacePropagator, NDArray[np.complex128], FreeSpacePropagator]:
        into, out_of = self._transfers
        size = max(self.lens_grids[0].size, into.samples, out_of.samples)
        check_grid_size(self.name, size, self.cost(), self._force)
        return into, self._phase(), out_of

    def _forward(self, values: Any) -> Any:
        into, phase, out_of = self._prepared
        return out_of.forward(into.forward(np.asarray(values, complex)) * phase)

    def _adjoint(self, values: Any) -> Any:
        into, phase, out_of = self._prepared
        return into.adjoint(out_of.adjoint(np.asarray(values, complex)) * phase.conj())

    def settings(self) -> dict[str, Any]:
        return {"pitch_mm": self.lens_grids[0].pitch_mm}

    def error_terms(self) -> tuple[ErrorTerm, ...]:
        waves, error = self._misfit()
        description = (
            f"thickness and aberrations of the lens: {waves:.3g} waves rms of the middle object point"
        )
        found = [ErrorTerm(description, error), *self._surface_figure_terms()]
        return tuple(sorted(found, key=lambda term: -term.relative_error))

    def _surface_figure_terms(self) -> list[ErrorTerm]:
        """Return an error term for the figure of each surface, as the phase that it adds along the axis."""
        scene, found = self.scene, []
        for i, figures in enumerate(scene.system.figures):
            semi = scene.lens.surfaces[i].semi_diameter_mm or min(
                (f.semi_diameter_mm for f in figures), default=0.0
            )
            for figure in figures:
                _, rms = pv_rms_waves(figure, semi)
                step = abs(float(scene.system.index[0, i + 1] - scene.system.index[0, i]))
                waves = rms * step * TEST_WAVELENGTH_UM / scene.wavelength_um
                error = min(2.0 * math.pi * waves, math.sqrt(2.0))
                found.append(ErrorTerm(f"figure of surface {i + 1}: {waves:.3g} waves rms", error))
        return found

    def _misfit(self) -> tuple[float, float]:
        """Return the rms difference of optical path in waves, without its mean, and the field's relative
        error.

        Both come from the rays of one object point in a meridional plane of the nominal lens.
        """
        scene, lens = self.scene, self.scene.lens
        x, y = scene.object_grid.centre_mm
        height = y if scene.object_grid.is_line else math.hypot(x, y)
        nominal = compile_system(lens, scene.wavelength_um)
        origins, headings = launch_compiled(
            nominal,
            [(0.0, height)],
            pupil_fan(FAN_RAYS).points,
            scene.object_grid.z_mm,
            lens.stop_index,
            lens.stop_semi_diameter_mm * (1.0 - 1e-9),
        )
        rays = trace_compiled(nominal, origins, headings, scene.exit_grid.z_mm)
        if not np.any(rays.ok):
            raise InputError(f"no ray from the object point at y = {height:g} mm gets through the lens")
        landing, path = self._thin_rays(height)
        reached = rays.position[rays.ok, 1]
        apart = rays.opl[rays.ok] - np.interp(reached, landing, path, left=np.nan, right=np.nan)
        both = np.isfinite(apart)
        # Where only one of the two fields has light, all of its energy is wrong.
        phase = scene.wavenumber_per_mm * apart[both]
        energy = np.sum(2.0 - 2.0 * np.cos(phase)) + 2.0 * np.count_nonzero(~both)
        rms = float(np.std(phase)) / (2.0 * math.pi) if np.any(both) else math.nan
        return rms, math.sqrt(float(energy) / len(apart))

    def _thin_rays(self, height_mm: float) -> tuple[Array, Array]:
        """Return where rays through the thin lens meet the exit plane, ascending, and their paths."""
        scene = self.scene
        thin = _thin_lens(Scene(scene.lens, scene.object_grid, scene.exit_grid, scene.wavelength_um))
        before, behind = scene.system.index[0, [0, -1]]
        at = np.linspace(-1.0, 1.0, FAN_RAYS) * thin.semi_diameter_mm
        first = np.hypot(at - height_mm, thin.front_mm[2] - scene.object_grid.z_mm)
        sine = (before * (at - height_mm) / first - thin.power_per_mm * at) / behind
        at, first, sine = (a[np.abs(sine) < 1.0] for a in (at, first, sine))
        second = (scene.exit_grid.z_mm - thin.rear_mm[2]) / np.sqrt(1.0 - sine**2)
        path = before * first - 0.5 * thin.power_per_mm * at**2 + thin.extra_path_mm + behind * second
        landing = at + sine * second
        plate = scene.system.cover_glass
        if plate is not None:
            cosines = np.stack([np.zeros_like(sine), sine], axis=-1)
            landing, path = (
                landing + plate.lateral_shift_mm(cosines)[:, 1],
                path + plate.added_path_mm(cosines),
            )
        order = np.argsort(landing)
        return landing[order], path[order]

    def cost(self) -> Cost:
        into, out_of = self._transfers
        size = self.lens_grids[0].size
        largest = max(into.peak_bytes, out_of.peak_bytes)
        seconds = into.seconds + out_of.seconds + pass_seconds(size)
        setup = exponential_seconds(size) + 6.0 * pass_seconds(size)
        return Cost(seconds, setup, max(largest + 32 * size, 64 * size))

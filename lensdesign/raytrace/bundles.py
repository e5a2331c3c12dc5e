"""Ray bundles: from field points through the aperture stop.

Bundles are aimed at the stop surface itself: a ray is identified by its field point and by its point on the
stop. No entrance pupil is assumed, so the stop of a perturbed lens is filled correctly.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError
from lensdesign.lens.lens import Lens
from lensdesign.lens.poses import Pose, SurfacePerturbation
from lensdesign.raytrace.compiled import CompiledSystem, compile_system
from lensdesign.raytrace.rays import trace_compiled


@dataclass(frozen=True)
class PupilSamples:
    """Points on the stop, relative to its semi-diameter, with quadrature weights.

    Attributes
    ----------
    points : ndarray, shape (n, 2)
        x and y inside the unit disc.
    weights : ndarray, shape (n,)
        Quadrature weights with the sum 1. The mean over the uniformly filled stop (for a fan, over its line)
        is ``sum(weights * values)``.
    """

    points: Array
    weights: Array


def pupil_rings(rings: int = 6, arms: int = 24, edge: bool = False) -> PupilSamples:
    """Return rings for means over a uniformly filled stop (Gauss-Legendre in r^2).

    Parameters
    ----------
    rings, arms
        Number of rings, and number of points on each ring.
    edge
        Whether to add a ring on the rim with weight 0, for largest and smallest values.

    References
    ----------
    G. W. Forbes, "Optical system assessment for design: numerical ray tracing in the Gaussian pupil",
    J. Opt. Soc. Am. A 5, 1943 (1988).
    """
    nodes, weights = np.polynomial.legendre.leggauss(rings)
    radii = np.sqrt(0.5 * (nodes + 1.0))
    weights = 0.5 * weights
    if edge:
        radii, weights = np.append(radii, 1.0), np.append(weights, 0.0)
    angle = 2.0 * np.pi * np.arange(arms) / arms
    points = np.stack([np.outer(radii, np.cos(angle)), np.outer(radii, np.sin(angle))], axis=-1)
    return PupilSamples(points.reshape(-1, 2), np.repeat(weights / arms, arms))


def largest_cosine(lens: Lens) -> float:
    """Return a transverse direction cosine that no ray through the aperture exceeds.

    Rays from the edge of the field are a little steeper than the aperture on the axis.
    """
    return min(0.999, 1.2 * lens.object.numerical_aperture)


def pupil_fan(rays: int) -> PupilSamples:
    """Return a meridional fan along y, from rim to rim."""
    y = np.linspace(-1.0, 1.0, rays)
    return PupilSamples(np.stack([np.zeros(rays), y], axis=-1), np.full(rays, 1.0 / rays))


def pupil_hexapolar(rings: int = 6) -> PupilSamples:
    """Return the centre and rings of 6, 12, 18, ... points, which fill the stop uniformly.

    Parameters
    ----------
    rings
        Number of rings around the centre.

    Returns
    -------
    PupilSamples
        Points relative to the semi-diameter of the stop, shape (1 + 3 rings (rings + 1), 2), and equal
        weights.

    Examples
    --------
    >>> from lensdesign import pupil_hexapolar
    >>> pupil_hexapolar(2).points.shape
    (19, 2)
    """
    points = [np.zeros((1, 2))]
    for ring in range(1, rings + 1):
        angle = 2.0 * np.pi * np.arange(6 * ring) / (6 * ring)
        points.append(ring / rings * np.stack([np.cos(angle), np.sin(angle)], axis=-1))
    stacked = np.concatenate(points)
    return PupilSamples(stacked, np.full(len(stacked), 1.0 / len(stacked)))


def launch(
    lens: Lens,
    field_points_mm: ArrayLike,
    pupil_points: ArrayLike,
    wavelength_um: float,
    pose: Pose = Pose(),
    surface_perturbations: Mapping[int, SurfacePerturbation] | None = None,
) -> tuple[Array, Array]:
    """Return rays from object points through points of the stop.

    Each ray is aimed at the stop itself, not at an entrance pupil. The stop of a perturbed lens is therefore
    filled correctly.

    Parameters
    ----------
    lens
        The nominal lens.
    field_points_mm
        x and y of object points on the object plane, shape (fields, 2).
    pupil_points
        Points on the stop relative to its semi-diameter, shape (points, 2).
    wavelength_um
        Vacuum wavelength.
    pose
        Pose of the whole lens (default: nominal).
    surface_perturbations
        Perturbations of single surfaces by index from 0 (default: none). The stop moves with its surface.

    Returns
    -------
    origins, directions : ndarray, shape (fields * points, 3) or (trials, fields * points, 3)
        Origins in mm and direction cosines: all rays of the first object point, then those of the second, and
        so on. A ray that cannot reach its stop point is aimed as closely as possible.

    Raises
    ------
    InputError
        If points are not finite or not of shape (n, 2), or a perturbation is not valid.

    Examples
    --------
    >>> from lensdesign import launch, load_design
    >>> lens = load_design("designs/paper_singlet.toml")
    >>> origins, directions = launch(lens, [(0.0, 1.5)], [(0.0, 0.0), (0.0, 1.0)], wavelength_um=0.532)
    >>> origins.tolist()
    [[0.0, 1.5, -13.5], [0.0, 1.5, -13.5]]
    >>> directions[:, 1].round(3).tolist()
    [-0.11, 0.427]
    """
    system = compile_system(lens, wavelength_um, pose, surface_perturbations)
    return launch_compiled(
        system, field_points_mm, pupil_points, lens.object_z_mm, lens.stop_index, lens.stop_semi_diameter_mm
    )


def launch_compiled(
    system: CompiledSystem,
    field_points_mm: ArrayLike,
    pupil_points: ArrayLike,
    object_z_mm: float,
    stop_index: int,
    stop_semi_diameter_mm: float,
) -> tuple[Array, Array]:
    """Return the rays of :func:`launch` for a compiled system: every field point with every stop point."""
    fields, pupil = _points(field_points_mm, "field_points_mm"), _points(pupil_points, "pupil_points")
    return launch_pairs(
        system,
        np.repeat(fields, len(pupil), axis=0),
        np.tile(pupil, (len(fields), 1)),
        object_z_mm,
        stop_index,
        stop_semi_diameter_mm,
    )


def launch_pairs(
    system: CompiledSystem,
    field_points_mm: Array,
    pupil_points: Array,
    object_z_mm: float,
    stop_index: int,
    stop_semi_diameter_mm: float,
) -> tuple[Array, Array]:
    """Return rays for a compiled system, one from each field point through the stop point of equal index.

    The direction to a stop point beyond the edge of its surface is NaN.
    """
    origins = np.empty((len(field_points_mm), 3))
    origins[:, :2] = field_points_mm
    origins[:, 2] = object_z_mm
    xy = stop_semi_diameter_mm * pupil_points
    targets = _stop_points(system, stop_index, xy)
    directions = targets - origins
    dx, dy, dz = np.moveaxis(directions, -1, 0)  # np.sum over an axis of length 3 is slow
    directions /= np.sqrt(dx * dx + dy * dy + dz * dz)[..., None]
    if stop_index > 0:
        on_surface = np.isfinite(directions).all(axis=-1, keepdims=True)
        aimed = _aim(system, stop_index, origins, np.where(on_surface, directions, [0.0, 0.0, 1.0]), xy)
        directions = np.where(on_surface, aimed, np.nan)
    return origins, directions if system.trials is not None else directions[0]


def _points(values: ArrayLike, name: str) -> Array:
    array = np.atleast_2d(np.asarray(values, float))
    if array.ndim != 2 or array.shape[1] != 2 or not np.all(np.isfinite(array)):
        raise InputError(f"{name} has shape {array.shape}: must be finite values of shape (n, 2)")
    return array


def _stop_points(system: CompiledSystem, stop: int, xy: Array) -> Array:
    """Return points of the stop surface in the fixed frame, shape (trials or 1, n, 3)."""
    sag = np.atleast_2d(system.shapes[stop].sag(xy[:, 0], xy[:, 1]))
    for figure in system.figures[stop]:
        sag = sag + figure.sag(xy[:, 0], xy[:, 1])
    local = np.empty((*sag.shape, 3))
    local[..., :2] = xy
    local[..., 2] = sag
    if system.tilted[stop]:
        local = local @ np.swapaxes(system.rotation[:, stop], -1, -2)
    return local + system.vertex[:, None, stop]


def _aim(system: CompiledSystem, stop: int, origins: Array, directions: Array, xy: Array) -> Array:
    """Correct directions by Newton's method until the rays hit the given points of an inner stop."""
    front = system.part(0, stop + 1)
    trials = 1 if system.trials is None else system.trials
    cosines = np.array(np.broadcast_to(directions, (trials, *directions.shape[1:]))[..., :2])

    def residual(cosines: Array) -> tuple[Array, NDArray[np.bool_]]:
        rays = trace_compiled(front, origins, directions_of(cosines), clip=False)
        position = rays.position.reshape(trials, -1, 3)
        local = (position - system.vertex[:, None, stop]) @ system.rotation[:, stop]
        return local[..., :2] - xy, rays.ok.reshape(trials, -1)

    step = 1e-6
    error, ok = residual(cosines)
    for _ in range(12):
        if not np.any(ok & (np.linalg.norm(error, axis=-1) > 1e-11)):
            break
        columns = [(residual(cosines + step * axis)[0] - error) / step for axis in np.eye(2)]
        jacobian = np.stack(columns, axis=-1)
        usable = ok & (np.abs(np.linalg.det(jacobian)) > 1e-9)
        jacobian[~usable] = np.eye(2)
        change = np.linalg.solve(jacobian, error[..., None])[..., 0] * usable[..., None]
        trial = np.clip(cosines - change, -0.99, 0.99)
        trial_error, trial_ok = residual(trial)
        better = usable & trial_ok & (np.linalg.norm(trial_error, axis=-1) < np.linalg.norm(error, axis=-1))
        if not np.any(better):
            break
        cosines[better], error[better] = trial[better], trial_error[better]
    return directions_of(cosines)


def directions_of(cosines: Array) -> Array:
    """Return unit vectors with the direction cosines L and M.

    Where L^2 + M^2 exceeds 0.999, both are reduced to this limit, so that N is real.
    """
    square = np.sum(cosines * cosines, axis=-1, keepdims=True)
    scale = np.where(square < 0.999, 1.0, np.sqrt(0.999 / np.maximum(square, 1e-300)))
    cosines = cosines * scale
    along_z = np.sqrt(1.0 - np.sum(cosines * cosines, axis=-1, keepdims=True))
    return np.ascontiguousarray(np.concatenate([cosines, along_z], axis=-1))

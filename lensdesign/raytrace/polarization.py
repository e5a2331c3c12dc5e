"""Polarization of light along rays: one Jones matrix for each ray.

The electric field of a ray has two components along unit vectors across its direction. They follow from x and
y by the smallest rotation from the z axis to the direction (the double-pole basis), so that on the axis they
are x and y. A Jones matrix maps the components at the object to those behind the last surface. Its elements
are normalized to flux: ideal coatings give a unitary matrix, and the squared moduli are transmittances.

:func:`polarization_matrices` computes the same with polarization ray-tracing matrices of three rows.

References
----------
G. Yun, K. Crabtree and R. A. Chipman, "Three-dimensional polarization ray-tracing calculus I", Applied
Optics 50, 2855 (2011). R. A. Chipman, W.-S. T. Lam and G. Young, "Polarized Light and Optical Systems"
(2018), chapter 11.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError
from lensdesign.lens.coatings.thin_films import Coefficients
from lensdesign.lens.lens import Lens
from lensdesign.lens.poses import Pose, SurfacePerturbation
from lensdesign.raytrace.compiled import CompiledSystem, compile_system
from lensdesign.raytrace.rays import RayTrace, trace_compiled

ComplexArray = NDArray[np.complex128]


@dataclass(frozen=True, eq=False)
class PolarizedRays:
    """Jones matrices of rays, with their directions.

    Arrays have the leading axes of the trace: rays, or trials and rays. Values of rays that did not arrive
    are NaN.

    Attributes
    ----------
    jones : ndarray, shape (..., 2, 2)
        Components behind the last surface from those in front of the first.
    before, after : ndarray, shape (..., 3)
        Directions in which the light travels in front of the first surface and behind the last.
    cos_incidence : ndarray, shape (..., surfaces)
        Cosines of the angles of incidence; 1 for rays that did not arrive.

    Examples
    --------
    The transmittance of the uncoated lens of the paper for unpolarized light on the axis:

    >>> from lensdesign import launch, load_design, trace_polarized
    >>> lens = load_design("designs/paper_singlet.toml")
    >>> bare = lens.with_coating("bare")
    >>> rays = trace_polarized(bare, *launch(bare, [(0.0, 0.0)], [(0.0, 0.0)], 0.532), 0.532)
    >>> rays.transmittance.round(4).tolist()
    [0.9168]
    """

    jones: ComplexArray
    before: Array
    after: Array
    cos_incidence: Array

    @property
    def transmittance(self) -> Array:
        """Transmittance of unpolarized light."""
        return np.asarray(0.5 * np.sum(np.abs(self.jones) ** 2, axis=(-2, -1)))

    @property
    def diattenuation(self) -> Array:
        """(largest - smallest) / (largest + smallest) transmittance over all polarizations."""
        squares = np.linalg.svd(_finite(self.jones), compute_uv=False) ** 2
        ratio = (squares[..., 0] - squares[..., 1]) / (squares[..., 0] + squares[..., 1])
        return np.where(self._ok, ratio, np.nan)

    @property
    def retardance_rad(self) -> Array:
        """Difference of phase between the eigenpolarizations of the unitary part, from 0 to pi."""
        left, _, right = np.linalg.svd(_finite(self.jones))
        unitary = left @ right
        cosine = 0.5 * np.abs(np.trace(unitary, axis1=-2, axis2=-1))
        traceless = unitary - 0.5 * np.trace(unitary, axis1=-2, axis2=-1)[..., None, None] * np.eye(2)
        sine = np.sqrt(0.5) * np.linalg.norm(traceless, axis=(-2, -1))
        return np.where(self._ok, 2.0 * np.arctan2(sine, cosine), np.nan)

    def fields(self, polarization: ComplexArray) -> ComplexArray:
        """Return the components behind the lens for a Jones vector in front of it, shape (..., 2)."""
        return np.asarray(self.jones @ np.asarray(polarization, complex))

    @property
    def _ok(self) -> NDArray[np.bool_]:
        return np.asarray(np.isfinite(self.jones).all(axis=(-2, -1)))


def _finite(matrices: ComplexArray) -> ComplexArray:
    """Return matrices with the identity in place of those that are not finite."""
    ok = np.isfinite(matrices).all(axis=(-2, -1), keepdims=True)
    return np.where(ok, matrices, np.eye(2))


def trace_polarized(
    lens: Lens,
    origins: ArrayLike,
    directions: ArrayLike,
    wavelength_um: float,
    pose: Pose = Pose(),
    *,
    surface_perturbations: Mapping[int, SurfacePerturbation] | None = None,
    clip: bool = True,
) -> PolarizedRays:
    """Trace rays through a lens with the coatings of its design, and return their Jones matrices.

    Parameters
    ----------
    lens, origins, directions, wavelength_um, pose, surface_perturbations, clip
        See :func:`lensdesign.trace`.

    Returns
    -------
    PolarizedRays

    Raises
    ------
    InputError
        See :func:`lensdesign.trace`; also if a coating's table ends before the angles of the rays.

    Examples
    --------
    >>> from lensdesign import launch, load_design, trace_polarized
    >>> lens = load_design("designs/paper_singlet.toml").with_surface(0, coating="mgf2")
    >>> rays = trace_polarized(lens, *launch(lens, [(0.0, 0.0)], [(0.0, 0.0), (0.0, 1.0)], 0.532), 0.532)
    >>> rays.transmittance.round(4).tolist(), rays.diattenuation.round(4).tolist()
    ([0.9867, 0.9814], [0.0, 0.016])
    """
    system = compile_system(lens, wavelength_um, pose, surface_perturbations)
    rays = trace_compiled(system, origins, directions, clip=clip, record_hits=True)
    return jones_matrices(system, np.asarray(origins, float), rays)


def jones_matrices(system: CompiledSystem, origins: Array, rays: RayTrace) -> PolarizedRays:
    """Return the Jones matrices of traced rays.

    Parameters
    ----------
    system
        The lens, displaced or not, or the path of a ghost; see
        :func:`lensdesign.raytrace.ghosts.ghost_system`.
    origins
        Origins of the rays, with the axes of the trace.
    rays
        The trace, with `record_hits`.

    Raises
    ------
    InputError
        If the trace has no hits, or a coating's table ends before the angles of the rays.
    """
    from lensdesign.raytrace.polarization_kernel import chain_jones

    path = _path(system, origins, rays)
    shape = path.ok.shape
    count = path.ok.size
    coefficients = [_coefficients_along(system, path, i) for i in range(system.surfaces)]
    along_s = np.stack([np.broadcast_to(s, shape) for s, _ in coefficients], axis=-1)
    along_p = np.stack([np.broadcast_to(p, shape) for _, p in coefficients], axis=-1)
    result = np.empty((count, 2, 2), complex)
    chain_jones(
        np.ascontiguousarray(path.headings.reshape(count, system.surfaces + 1, 3)),
        np.ascontiguousarray(path.normals.reshape(count, system.surfaces, 3)),
        along_s.reshape(count, -1),
        along_p.reshape(count, -1),
        result,
    )
    result[~path.ok.ravel()] = np.nan
    before, after = path.headings[..., 0, :], path.headings[..., -1, :]
    return PolarizedRays(result.reshape(*shape, 2, 2), before, after, path.cosines)


def polarization_matrices(system: CompiledSystem, origins: Array, rays: RayTrace) -> ComplexArray:
    """Return polarization ray-tracing matrices of traced rays, shape (..., 3, 3).

    A matrix maps the electric field in front of the lens, as a vector in the fixed frame, to that behind it,
    both normalized to flux, and the direction in front to that behind. It is the reference for
    :func:`jones_matrices`; see there for parameters and errors.
    """
    path = _path(system, origins, rays)
    total = np.broadcast_to(np.eye(3, dtype=complex), (*path.ok.shape, 3, 3))
    for i in range(system.surfaces):
        before, after = path.headings[..., i, :], path.headings[..., i + 1, :]
        across = np.cross(before, path.normals[..., i, :])
        size = np.linalg.norm(across, axis=-1, keepdims=True)
        helper = np.where(np.abs(before[..., :1]) < 0.9, [1.0, 0.0, 0.0], [0.0, 1.0, 0.0])
        other = np.cross(before, helper)
        other /= np.linalg.norm(other, axis=-1, keepdims=True)
        s = np.where(size > 1e-12, across / np.where(size > 1e-12, size, 1.0), other)
        own = [
            np.broadcast_to(value, path.ok.shape) for value in (*_coefficients_along(system, path, i), 1.0)
        ]
        into = np.stack([s, np.cross(before, s), before], axis=-2)
        out = np.stack([s, np.cross(after, s), after], axis=-1)
        total = (out * np.stack(own, axis=-1)[..., None, :]) @ into @ total
    return np.where(path.ok[..., None, None], total, np.nan)


def incidence_cosines(system: CompiledSystem, origins: Array, rays: RayTrace) -> Array:
    """Return the cosines of the angles of incidence, shape (..., surfaces); 1 for rays that failed.

    Parameters are those of :func:`jones_matrices`.
    """
    return _path(system, origins, rays).cosines


def transverse_basis(directions: Array) -> Array:
    """Return the double-pole basis of directions, shape (..., 3, 2): x and y turned from z to each."""
    a, b, c = np.moveaxis(np.asarray(directions, float), -1, 0)
    shared = 1.0 / (1.0 + c)
    mixed = -a * b * shared
    x = np.stack([1.0 - a * a * shared, mixed, -a], axis=-1)
    y = np.stack([mixed, 1.0 - b * b * shared, -b], axis=-1)
    return np.stack([x, y], axis=-1)


@dataclass(frozen=True, eq=False)
class _Path:
    """Directions of travel in all media, normals of all surfaces along them, and cosines of incidence."""

    ok: NDArray[np.bool_]
    headings: Array
    normals: Array
    cosines: Array


def _path(system: CompiledSystem, origins: Array, rays: RayTrace) -> _Path:
    if rays.hits is None:
        raise InputError("the trace has no hits: trace the rays with record_hits = True")
    ok, index = rays.ok, np.abs(system.index)
    if ok.ndim > 1:
        index = index[:, None]
    points = np.concatenate([np.broadcast_to(origins, rays.position.shape)[..., None, :], rays.hits], axis=-2)
    legs = np.diff(points, axis=-2)
    lengths = np.linalg.norm(legs, axis=-1, keepdims=True)
    if np.any(lengths[ok] == 0.0):
        raise InputError("rays meet two surfaces at one point: give the space between them a thickness")
    with np.errstate(invalid="ignore", divide="ignore"):
        headings = np.concatenate([legs / lengths, rays.direction[..., None, :]], axis=-2)
        # By Snell's law in vector form, the normal is along the change of index times direction.
        normals = np.diff(index[..., None] * headings, axis=-2)
        size = np.linalg.norm(normals, axis=-1, keepdims=True)
        normals = normals / size
    same = ~(size[..., 0] > 1e-9)
    for i in range(system.surfaces):
        if np.any(same[..., i] & ok):
            normals[..., i, :] = _surface_normals(system, i, rays.hits[..., i, :])
    cosines = np.abs(np.sum(normals * headings[..., :-1, :], axis=-1))
    return _Path(ok, headings, normals, np.where(ok[..., None], np.minimum(cosines, 1.0), 1.0))


def _surface_normals(system: CompiledSystem, surface: int, points: Array) -> Array:
    """Return the normals of a surface at points in the fixed frame, of the first trial."""
    rotation, vertex = system.rotation[0, surface], system.vertex[0, surface]
    own = (points - vertex) @ rotation
    _, by_x, by_y = system.sag_and_slopes(surface, own[..., 0], own[..., 1])
    normal = np.stack([-by_x, -by_y, np.ones_like(by_x)], axis=-1)
    return np.asarray(normal / np.linalg.norm(normal, axis=-1, keepdims=True) @ rotation.T)


def _coefficients_along(system: CompiledSystem, path: _Path, i: int) -> tuple[ComplexArray, ComplexArray]:
    """Return the coefficients of s and p light at a surface, for the vectors of the 3 x 3 matrices."""
    coefficients, is_reflected = surface_coefficients(system, i, path.cosines[..., i])
    if is_reflected:
        # The vector k x s of reflected light is opposed along the surface to that of incident light.
        return coefficients.rs, -coefficients.rp
    return coefficients.ts, coefficients.tp


def axial_reflection(system: CompiledSystem, surface: int) -> complex:
    """Return the amplitude reflected at normal incidence by a surface of the first trial."""
    n1, n2 = system.index[0, surface : surface + 2]
    return complex(np.ravel(system.coatings[surface].coefficients(n1, n2, 1.0).rs)[0])


def surface_coefficients(
    system: CompiledSystem, surface: int, cos_incidence: Array
) -> tuple[Coefficients, bool]:
    """Return the amplitude coefficients of a surface, and whether it reflects the light.

    Parameters
    ----------
    system
        The lens, or the path of a ghost.
    surface
        Index from 0, in the order in which light meets the surfaces.
    cos_incidence
        Cosines of the angle of incidence, with axes of rays, or of trials and rays.

    Raises
    ------
    InputError
        If a coating's table ends before the largest angle; the message names the surface.
    """
    n1, n2 = (np.abs(system.index[:, i]) for i in (surface, surface + 1))
    beyond = None if system.index_beyond is None else system.index_beyond[:, surface]
    is_reflected = beyond is not None and bool(np.all(np.isfinite(beyond)))
    other = beyond if is_reflected and beyond is not None else n2
    if cos_incidence.ndim > 1:
        n1, other = n1[:, None], other[:, None]
    try:
        found = system.coatings[surface].coefficients(n1, other, cos_incidence)
    except InputError as error:
        raise InputError(f"surface {surface + 1}, coating: {error}") from error
    return found, is_reflected

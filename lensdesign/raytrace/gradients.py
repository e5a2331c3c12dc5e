"""Rays through the stop of a centred lens with exact derivatives by its design variables."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError
from lensdesign.lens.shapes.registry import needed_formulas
from lensdesign.raytrace.bundles import launch_pairs
from lensdesign.raytrace.compiled import CompiledSystem
from lensdesign.raytrace.plane_plate import PlanePlate
from lensdesign.raytrace.rays import trace_compiled
from lensdesign.raytrace.status import Status

KINDS = ("thickness", "working_distance", "launch_x", "launch_y", "log_field")
"""Variables that are not terms of a surface's shape."""


@dataclass(frozen=True)
class Variable:
    """A design variable of the ray derivatives.

    Attributes
    ----------
    kind
        ``thickness`` (mm), ``working_distance`` (mm), ``log_field`` (logarithm of a factor of all object
        points), or a term of the surface's shape: ``curvature`` (1/mm), ``conic``, ``asphere_4``, ...
    surface
        Index of the surface, from 0; unused for the working distance and the field.
    """

    kind: str
    surface: int = 0

    @property
    def is_shape_term(self) -> bool:
        """True if the variable is a term of the surface's shape."""
        return self.kind not in KINDS


@dataclass(frozen=True)
class ChainRule:
    """Derivatives of v ray variables, the stop and p planes with respect to w other variables.

    Attributes
    ----------
    variables : ndarray, shape (v, w)
        Derivatives of the ray variables.
    stop : ndarray, shape (w,)
        Derivatives of the semi-diameter of the stop.
    planes : ndarray, shape (p, w)
        Derivatives of the distances of the planes.
    """

    variables: Array
    stop: Array
    planes: Array

    def with_fixed_planes(self, count: int) -> ChainRule:
        """Return the same derivatives with planes at fixed distances."""
        return replace(self, planes=np.zeros((count, len(self.stop))))


@dataclass(frozen=True)
class GradientTrace:
    """Rays with their derivatives: n rays, s surfaces, p planes, v variables.

    Attributes
    ----------
    heights : ndarray, shape (n, s, 2)
        x and y on every surface in mm.
    cosines : ndarray, shape (n, 2)
        Direction cosines along x and y behind the lens.
    plane_points : ndarray, shape (n, p, 2)
        x and y on every plane in mm.
    heights_by, cosines_by, plane_points_by : ndarray
        Derivatives, with a last axis of length v.
    stop_semi_diameter_mm : float
        Semi-diameter of the stop that the rays fill.
    stop_semi_diameter_by : ndarray, shape (v,)
        Derivatives of the semi-diameter of the stop.
    ok : ndarray of bool, shape (n,)
        Whether each ray arrived; the values of other rays are undefined.
    """

    heights: Array
    cosines: Array
    plane_points: Array
    heights_by: Array
    cosines_by: Array
    plane_points_by: Array
    stop_semi_diameter_mm: float
    stop_semi_diameter_by: Array
    ok: NDArray[np.bool_]


def at_wavelengths(systems: Sequence[CompiledSystem]) -> CompiledSystem:
    """Return one system with a trial for each wavelength; trials differ only in their refractive index."""
    index = np.concatenate([system.index for system in systems])
    plates = [system.cover_glass for system in systems if system.cover_glass is not None]
    plate = replace(plates[0], index=np.concatenate([p.index for p in plates])) if plates else None
    return replace(systems[0], trials=len(systems), index=index, cover_glass=plate)


def gradient_traces(
    system: CompiledSystem,
    object_z_mm: float,
    planes_mm: Array,
    stop_index: int,
    stop_semi_diameter_mm: float | None,
    numerical_aperture: float,
    fields_mm: Array,
    pupil: Array,
    variables: tuple[Variable, ...],
    chain_rule: ChainRule | None = None,
) -> tuple[GradientTrace, ...]:
    """Trace rays at each wavelength through fixed points of the stop, with their derivatives.

    Parameters
    ----------
    system
        A centred lens without tilts at one wavelength, or at several: see :func:`at_wavelengths`.
    object_z_mm
        z of the object plane, in front of the lens.
    planes_mm
        Distances of planes from the exit vertex, shape (p,).
    stop_index, stop_semi_diameter_mm
        Index and semi-diameter of the stop. With None the semi-diameter is computed such that the axial rim
        ray starts at the numerical aperture; it then depends on the variables.
    numerical_aperture
        Sine of the angle of the axial rim ray.
    fields_mm, pupil
        Object point in mm, and stop point relative to the semi-diameter, of each ray; shape (n, 2) each.
    variables
        Variables of the derivatives. Without variables, the rays are traced by the faster kernel of
        :func:`lensdesign.trace`.
    chain_rule
        Derivatives of the variables, a given stop and the planes with respect to other variables, by which
        the rays are then differentiated (default: the variables themselves).

    Returns
    -------
    tuple of GradientTrace
        The rays at each wavelength.

    Raises
    ------
    InputError
        If a surface has a measured figure, or lacks the term of a variable.
    """
    if any(system.figures):
        raise InputError(
            "ray derivatives exist for nominal surfaces only; remove the measured figures from the lens"
        )
    count, rays = len(system.index), len(pupil)
    traced = _traced_variables(system, variables) if variables or chain_rule is not None else None
    if stop_semi_diameter_mm is None:
        semi, semi_by, reached = _stop_sizes(system, object_z_mm, stop_index, numerical_aperture, traced)
    else:
        semi, semi_by = np.full(count, stop_semi_diameter_mm), np.zeros((count, len(variables)))
        reached = np.ones(count, bool)
    origins, directions = _launched(system, fields_mm, pupil, object_z_mm, stop_index, semi)
    if traced is None:
        raw = _trace_only(system, origins, directions, planes_mm)
        usable = raw.ok & np.repeat(reached, rays)
    else:
        raw = _differentiate(system, origins, directions, planes_mm, traced)
        if chain_rule is not None:
            raw, semi_by = _with_chain_rule(raw, chain_rule), np.tile(chain_rule.stop, (count, 1))
        stop_by = (pupil[None, :, :, None] * semi_by[:, None, None]).reshape(count * rays, 2, -1)
        raw, usable = _at_fixed_stop_points(raw, stop_index, stop_by)
        usable &= np.repeat(reached, rays)
        if not usable.all():
            raw.derivatives[~usable] = 0.0
    if system.cover_glass is not None:
        raw = _behind_plate(raw, system.cover_glass, system.surfaces)
    return tuple(
        raw.select(slice(w * rays, (w + 1) * rays), system.surfaces, float(semi[w]), semi_by[w], usable)
        for w in range(count)
    )


@dataclass(frozen=True)
class _Rays:
    """Traced rays at all wavelengths: n rays, k = s + 1 + p slots (surfaces, cosines, planes).

    Attributes
    ----------
    values : ndarray, shape (n, k, 2)
        x and y on every surface, direction cosines behind the lens, and x and y on every plane.
    derivatives : ndarray, shape (n, k, 2, v)
        Their derivatives.
    ok : ndarray of bool, shape (n,)
        Whether each ray arrived.
    """

    values: Array
    derivatives: Array
    ok: NDArray[np.bool_]

    def select(
        self, rays: slice, surfaces: int, semi: float, semi_by: Array, usable: NDArray[np.bool_]
    ) -> GradientTrace:
        """Return the rays of one wavelength."""
        values, by = self.values[rays], self.derivatives[rays]
        return GradientTrace(
            heights=values[:, :surfaces],
            cosines=values[:, surfaces],
            plane_points=values[:, surfaces + 1 :],
            heights_by=by[:, :surfaces],
            cosines_by=by[:, surfaces],
            plane_points_by=by[:, surfaces + 1 :],
            stop_semi_diameter_mm=semi,
            stop_semi_diameter_by=semi_by,
            ok=usable[rays],
        )


def _behind_plate(raw: _Rays, plate: PlanePlate, surfaces: int) -> _Rays:
    """Return the rays with their points on planes behind a plate, and the derivatives of these points."""
    values, derivatives = raw.values.copy(), raw.derivatives.copy()
    cosines = np.where(raw.ok[:, None], raw.values[:, surfaces], 0.0)
    by_wavelength = cosines.reshape(len(plate.index), -1, 2)
    shift = plate.lateral_shift_mm(by_wavelength).reshape(-1, 2)
    slopes = plate.shift_by_cosines(by_wavelength).reshape(-1, 2, 2)
    values[:, surfaces + 1 :] += shift[:, None]
    derivatives[:, surfaces + 1 :] += (slopes @ raw.derivatives[:, surfaces])[:, None]
    return replace(raw, values=values, derivatives=derivatives)


def _launched(
    system: CompiledSystem,
    fields_mm: Array,
    pupil: Array,
    object_z_mm: float,
    stop_index: int,
    semi: Array,
) -> tuple[Array, Array]:
    """Return origins and directions of the rays at all wavelengths, one wavelength after the other."""
    if stop_index == 0:  # no glass before the stop: all wavelengths are launched alike
        points = (semi[:, None, None] * pupil).reshape(-1, 2)
        fields = np.tile(fields_mm, (len(semi), 1))
        return launch_pairs(replace(system, trials=None), fields, points, object_z_mm, 0, 1.0)
    each = [
        launch_pairs(
            replace(system, trials=None, index=index), fields_mm, pupil, object_z_mm, stop_index, own
        )
        for index, own in zip(system.index[:, None], semi, strict=True)
    ]
    origins, directions = zip(*each, strict=True)
    return np.concatenate(origins), np.concatenate(directions)


def _trace_only(system: CompiledSystem, origins: Array, directions: Array, planes_mm: Array) -> _Rays:
    """Return the rays at all wavelengths without derivatives."""
    shape = (len(system.index), -1, 3)
    # A stop point beyond the edge of its surface has no direction.
    is_launched = np.all(np.isfinite(directions), axis=-1)
    launched = np.where(is_launched[:, None], directions, [0.0, 0.0, 1.0])
    rays = trace_compiled(
        system, origins.reshape(shape), launched.reshape(shape), clip=False, record_hits=True
    )
    assert rays.hits is not None  # they are recorded
    surfaces = system.surfaces
    hits, directions = rays.hits.reshape(-1, surfaces, 3), rays.direction.reshape(-1, 3)
    values = np.empty((len(hits), surfaces + 1 + len(planes_mm), 2))
    values[:, :surfaces], values[:, surfaces] = hits[:, :, :2], directions[:, :2]
    slopes = directions[:, :2] / directions[:, 2:]
    to_vertex = system.vertex[0, -1, 2] - hits[:, -1, 2:]
    for plane, distance in enumerate(planes_mm):
        values[:, surfaces + 1 + plane] = hits[:, -1, :2] + (to_vertex + distance) * slopes
    return _Rays(values, np.zeros((*values.shape, 0)), rays.ok.ravel() & is_launched)


def _at_fixed_stop_points(raw: _Rays, stop: int, stop_by: Array) -> tuple[_Rays, NDArray[np.bool_]]:
    """Return derivatives at fixed relative points of the stop, and whether each ray allows them.

    The last two columns of the given derivatives are those by the launch cosines, which change such that the
    ray meets its point of the stop. `stop_by`, shape (n, 2, v), has the derivatives of these points.
    """
    by, launch = raw.derivatives[..., :-2], raw.derivatives[..., -2:]
    at_stop = launch[:, stop]
    a, b, c, d = at_stop[:, 0, 0], at_stop[:, 0, 1], at_stop[:, 1, 0], at_stop[:, 1, 1]
    determinant = a * d - b * c
    usable = raw.ok & (np.abs(determinant) > 1e-12) & np.isfinite(determinant)
    inverse = 1.0 / np.where(usable, determinant, 1.0)
    missing = stop_by - by[:, stop]
    along_l = inverse[:, None] * (d[:, None] * missing[:, 0] - b[:, None] * missing[:, 1])
    along_m = inverse[:, None] * (a[:, None] * missing[:, 1] - c[:, None] * missing[:, 0])
    total = launch[..., :1] * along_l[:, None, None]
    total += launch[..., 1:] * along_m[:, None, None]
    total += by
    return replace(raw, derivatives=total), usable


def _with_chain_rule(raw: _Rays, chain_rule: ChainRule) -> _Rays:
    """Return the derivatives by other variables at fixed launch directions; the last two columns stay."""
    v, w = chain_rule.variables.shape
    whole = np.zeros((v + 2, w + 2))
    whole[:v, :w], whole[v:, w:] = chain_rule.variables, np.eye(2)
    planes = len(chain_rule.planes)
    cosines = raw.values[:, -1 - planes]
    forward = np.sqrt(1.0 - np.sum(cosines**2, axis=-1, keepdims=True))
    derivatives = raw.derivatives @ whole
    slopes = (cosines / forward)[:, None, :, None]
    derivatives[:, len(derivatives[0]) - planes :, :, :w] += slopes * chain_rule.planes[:, None]
    return replace(raw, derivatives=derivatives)


def _stop_sizes(
    system: CompiledSystem,
    object_z_mm: float,
    stop: int,
    numerical_aperture: float,
    variables: _TracedVariables | None,
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Return the semi-diameter of the stop, its derivatives, and whether the axial rim ray reaches it.

    The values are those of each wavelength.
    """
    count = len(system.index)
    origins = np.tile([0.0, 0.0, object_z_mm], (count, 1))
    axial_rim = [0.0, numerical_aperture, np.sqrt(1.0 - numerical_aperture**2)]
    directions, no_planes = np.tile(axial_rim, (count, 1)), np.empty(0)
    if variables is None:
        rim = _trace_only(system, origins, directions, no_planes)
        return rim.values[:, stop, 1], rim.derivatives[:, stop, 1], rim.ok
    rim = _differentiate(system, origins, directions, no_planes, variables)
    return rim.values[:, stop, 1], rim.derivatives[:, stop, 1, :-2], rim.ok


@dataclass(frozen=True)
class _TracedVariables:
    """Variables of the traced formulas and of the launch, as the kernel needs them: v of them, w own ones.

    Attributes
    ----------
    kind, surface, term : ndarray of int, shape (v,)
        Kind of each variable, its surface, and its term in the formula of that surface.
    combination : ndarray, shape (v, w), or None
        How own variables and launch combine the traced ones; None if they are equal.
    """

    kind: NDArray[np.int64]
    surface: NDArray[np.int64]
    term: NDArray[np.int64]
    combination: Array | None


def _differentiate(
    system: CompiledSystem, origins: Array, directions: Array, planes_mm: Array, variables: _TracedVariables
) -> _Rays:
    """Return derivatives at fixed launch directions, with two columns more for the launch cosines.

    The rays are those of one wavelength after the other.
    """
    from lensdesign.raytrace.gradient_kernel import gradient_kernel

    n, s, p, v = len(origins), system.surfaces, len(planes_mm), len(variables.kind)
    values, derivatives = np.zeros((n, s + 1 + p, 2)), np.zeros((n, s + 1 + p, 2, v))
    status, failed = np.empty(n, np.int8), np.empty(n, np.int16)
    codes, starts, terms = system.packed_shapes
    gradient_kernel(
        np.ascontiguousarray(origins),
        np.ascontiguousarray(directions),
        np.ascontiguousarray(system.vertex[0, :, 2]),
        codes if np.any(codes) else None,
        needed_formulas(codes.tobytes(), 0),
        starts[0],
        terms[0],
        system.index,
        np.ascontiguousarray(planes_mm, dtype=float),
        variables.kind,
        variables.surface,
        variables.term,
        values,
        derivatives,
        status,
        failed,
    )
    if variables.combination is not None:
        derivatives = derivatives @ variables.combination
    return _Rays(values, derivatives, status == Status.OK)


def _traced_variables(system: CompiledSystem, variables: tuple[Variable, ...]) -> _TracedVariables:
    """Return the variables of the traced formulas and of the launch by which own variables are expressed."""
    own = (*variables, Variable("launch_x"), Variable("launch_y"))
    parts = [
        {Variable(term, x.surface): by for term, by in system.shapes[x.surface].traced_by(x.kind).items()}
        if x.is_shape_term
        else {x: 1.0}
        for x in own
    ]
    traced = tuple(dict.fromkeys(one for part in parts for one in part))
    matrix = None
    if traced != own:
        matrix = np.zeros((len(traced), len(own)))
        for column, part in enumerate(parts):
            for one, by in part.items():
                matrix[traced.index(one), column] = by
    return _TracedVariables(
        np.array([0 if x.is_shape_term else 1 + KINDS.index(x.kind) for x in traced]),
        np.array([x.surface for x in traced]),
        np.array(
            [system.shapes[x.surface].traced.term_index(x.kind) if x.is_shape_term else 0 for x in traced]
        ),
        matrix,
    )

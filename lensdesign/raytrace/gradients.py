"""Rays through the stop of a centred lens with exact derivatives by its design variables."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError
from lensdesign.raytrace.bundles import launch_pairs
from lensdesign.raytrace.compiled import CompiledSystem
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


def gradient_trace(
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
) -> GradientTrace:
    """Trace rays through fixed points of the stop, with their derivatives.

    Parameters
    ----------
    system
        A centred lens (no trials, no tilts).
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
        Variables of the derivatives.
    chain_rule
        Derivatives of the variables, a given stop and the planes with respect to other variables, by which
        the rays are then differentiated (default: the variables themselves).

    Returns
    -------
    GradientTrace

    Raises
    ------
    InputError
        If a surface has a measured figure, or lacks the term of a variable.
    """
    if any(system.figures):
        raise InputError(
            "ray derivatives exist for nominal surfaces only; remove the measured figures from the lens"
        )
    semi, semi_by, reached = _stop_size(
        system, object_z_mm, stop_index, stop_semi_diameter_mm, numerical_aperture, variables
    )
    origins, directions = launch_pairs(system, fields_mm, pupil, object_z_mm, stop_index, semi)
    raw = _differentiate(system, origins, directions, planes_mm, variables)
    if chain_rule is not None:
        raw, semi_by = _with_chain_rule(raw, chain_rule), chain_rule.stop
    at_stop = raw.heights_by[:, stop_index]
    required = pupil[:, :, None] * semi_by
    v = len(semi_by)
    launch = at_stop[:, :, v:]
    usable = raw.ok & reached & np.all(np.isfinite(launch), axis=(1, 2))
    launch = np.where(usable[:, None, None], launch, np.eye(2))
    usable &= np.abs(np.linalg.det(launch)) > 1e-12
    launch = np.where(usable[:, None, None], launch, np.eye(2))
    # The launch cosines change such that the ray keeps its relative point on the stop.
    launch_by = np.linalg.solve(launch, required - at_stop[:, :, :v])

    def total(by: Array) -> Array:
        whole = by[..., :v] + np.einsum("n...l,nlv->n...v", by[..., v:], launch_by)
        whole[~usable] = 0.0
        return whole

    return replace(
        raw,
        heights_by=total(raw.heights_by),
        cosines_by=total(raw.cosines_by),
        plane_points_by=total(raw.plane_points_by),
        stop_semi_diameter_mm=semi,
        stop_semi_diameter_by=semi_by,
        ok=usable,
    )


def _with_chain_rule(raw: GradientTrace, chain_rule: ChainRule) -> GradientTrace:
    """Return the derivatives by other variables at fixed launch directions; the last two columns stay."""
    v, w = chain_rule.variables.shape
    whole = np.zeros((v + 2, w + 2))
    whole[:v, :w], whole[v:, w:] = chain_rule.variables, np.eye(2)
    forward = np.sqrt(1.0 - np.sum(raw.cosines**2, axis=-1, keepdims=True))
    planes = raw.plane_points_by @ whole
    planes[..., :w] += (raw.cosines / forward)[:, None, :, None] * chain_rule.planes[:, None]
    return replace(
        raw,
        heights_by=raw.heights_by @ whole,
        cosines_by=raw.cosines_by @ whole,
        plane_points_by=planes,
    )


def _stop_size(
    system: CompiledSystem,
    object_z_mm: float,
    stop: int,
    semi: float | None,
    numerical_aperture: float,
    variables: tuple[Variable, ...],
) -> tuple[float, Array, bool]:
    """Return the semi-diameter of the stop, its derivatives, and whether the axial rim ray reaches it."""
    if semi is not None:
        return semi, np.zeros(len(variables)), True
    direction = np.array([[0.0, numerical_aperture, np.sqrt(1.0 - numerical_aperture**2)]])
    rim = _differentiate(system, np.array([[0.0, 0.0, object_z_mm]]), direction, np.empty(0), variables)
    return float(rim.heights[0, stop, 1]), rim.heights_by[0, stop, 1, : len(variables)], bool(rim.ok[0])


def _differentiate(
    system: CompiledSystem,
    origins: Array,
    directions: Array,
    planes_mm: Array,
    variables: tuple[Variable, ...],
) -> GradientTrace:
    """Return derivatives at fixed launch directions, with two columns more for the launch cosines."""
    from lensdesign.raytrace.gradient_kernel import gradient_kernel

    every, combination = _traced_variables(system, variables)
    n, s, p, v = len(origins), system.surfaces, len(planes_mm), len(every)
    values, derivatives = np.zeros((n, s + 1 + p, 2)), np.zeros((n, s + 1 + p, 2, v))
    status, failed = np.empty(n, np.int8), np.empty(n, np.int16)
    codes, starts, terms = system.packed_shapes
    gradient_kernel(
        np.ascontiguousarray(origins),
        np.ascontiguousarray(directions),
        np.ascontiguousarray(system.vertex[0, :, 2]),
        codes if np.any(codes) else None,
        starts[0],
        terms[0],
        system.index[0],
        np.ascontiguousarray(planes_mm, dtype=float),
        np.array([0 if x.is_shape_term else 1 + KINDS.index(x.kind) for x in every]),
        np.array([x.surface for x in every]),
        np.array(
            [system.shapes[x.surface].traced.term_index(x.kind) if x.is_shape_term else 0 for x in every]
        ),
        values,
        derivatives,
        status,
        failed,
    )
    if combination is not None:
        derivatives = derivatives @ combination
    return GradientTrace(
        heights=values[:, :s],
        cosines=values[:, s],
        plane_points=values[:, s + 1 :],
        heights_by=derivatives[:, :s],
        cosines_by=derivatives[:, s],
        plane_points_by=derivatives[:, s + 1 :],
        stop_semi_diameter_mm=0.0,
        stop_semi_diameter_by=np.zeros(len(variables)),
        ok=status == Status.OK,
    )


def _traced_variables(
    system: CompiledSystem, variables: tuple[Variable, ...]
) -> tuple[tuple[Variable, ...], Array | None]:
    """Return variables of the traced formulas and of the launch, and how the own variables combine them.

    The matrix has the shape (traced variables, variables and launch); it is None where both are equal.
    """
    own = (*variables, Variable("launch_x"), Variable("launch_y"))
    parts = [
        {Variable(term, x.surface): by for term, by in system.shapes[x.surface].traced_by(x.kind).items()}
        if x.is_shape_term
        else {x: 1.0}
        for x in own
    ]
    traced = tuple(dict.fromkeys(one for part in parts for one in part))
    if traced == own:
        return own, None
    matrix = np.zeros((len(traced), len(own)))
    for column, part in enumerate(parts):
        for one, by in part.items():
            matrix[traced.index(one), column] = by
    return traced, matrix

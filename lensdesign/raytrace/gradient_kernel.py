"""Ray tracing through a centred lens with exact derivatives by design variables (forward mode), in Numba."""

from __future__ import annotations

import math

import numpy as np

from lensdesign.lens.shapes import compiled as shapes
from lensdesign.lens.shapes import intersection
from lensdesign.raytrace import conic_kernel, kernel
from lensdesign.raytrace.cached_kernels import cached_njit, drop_outdated
from lensdesign.raytrace.conic_kernel import MISSED, NOT_CONVERGED, OK, TOTAL_REFLECTION, conic_distance
from lensdesign.raytrace.kernel import CONIC, newton

SHAPE, THICKNESS, WORKING_DISTANCE, LAUNCH_X, LAUNCH_Y, LOG_FIELD = range(6)

_jit = cached_njit(nogil=True, error_model="numpy")


@_jit
def gradient_kernel(
    origins,
    directions,
    vertex,
    codes,
    formulas,
    starts,
    terms,
    index,
    planes,
    kind,
    surface_of,
    term,
    values,
    derivatives,
    status,
    failed,
):
    """Trace rays one by one, each with its derivatives.

    For n rays, s surfaces, p planes and v variables, the kernel fills `values` (n, s + 1 + p, 2) with x and y
    on every surface, then the direction cosines behind the lens, then x and y on every plane. It fills
    `derivatives` (n, s + 1 + p, 2, v) with their derivatives. Planes move with the last vertex.
    `index` has one row for each wavelength; the rays are those of one wavelength after the other.
    Variable j is described by kind[j], surface_of[j] (a surface) and term[j] (a term of its shape).
    `codes` is None if all surfaces are conics; other shapes are then not compiled.

    Below, p and d are the position and the direction cosines of a ray, and dp and dd are their derivatives by
    the variables, shape (3, v).
    """
    rays, variables, surfaces = origins.shape[0], kind.shape[0], vertex.shape[0]
    rays_per_wavelength = rays // index.shape[0]
    p, d = np.empty(3), np.empty(3)
    dp = np.empty((3, variables))
    dd = np.empty((3, variables))
    for i in range(rays):
        p[:], d[:] = origins[i], directions[i]
        own_index = index[i // rays_per_wavelength]
        _launch(p, d, dp, dd, kind)
        status[i] = OK
        failed[i] = -1
        for s in range(surfaces):
            outcome = _surface(
                p, d, dp, dd, vertex, codes, formulas, starts, terms, own_index, kind, surface_of, term, s
            )
            if outcome != OK:
                status[i] = outcome
                failed[i] = s
                break
            _store(values, derivatives, i, s, p, dp)
        if status[i] == OK:
            _store(values, derivatives, i, surfaces, d, dd)
            _planes(
                p, d, dp, dd, vertex[surfaces - 1], planes, kind, surface_of, values, derivatives, i, surfaces
            )


@_jit
def _store(values, derivatives, i, slot, vector, gradient):
    for a in range(2):
        values[i, slot, a] = vector[a]
        for j in range(gradient.shape[1]):
            derivatives[i, slot, a, j] = gradient[a, j]


@_jit
def _launch(p, d, dp, dd, kind):
    dp[:] = 0.0
    dd[:] = 0.0
    for j in range(kind.shape[0]):
        if kind[j] == WORKING_DISTANCE:
            dp[2, j] = -1.0
        elif kind[j] == LAUNCH_X:
            dd[0, j] = 1.0
            dd[2, j] = -d[0] / d[2]
        elif kind[j] == LAUNCH_Y:
            dd[1, j] = 1.0
            dd[2, j] = -d[1] / d[2]
        elif kind[j] == LOG_FIELD:
            dp[0, j] = p[0]
            dp[1, j] = p[1]


@_jit
def _vertex_motion(kind, surface_of, s):
    """Return the derivative of the z of vertex s with respect to a variable."""
    return 1.0 if kind == THICKNESS and surface_of < s else 0.0


@_jit
def _hit(p, d, codes, formulas, s, start, terms):
    """Return the distance from p (in the surface's frame) to surface s, and the status of the ray."""
    t, hit = conic_distance(p[0], p[1], p[2], d[0], d[1], d[2], start[0], start[1])
    if not hit:
        return 0.0, MISSED
    if codes is None:
        return t, OK
    if codes[s] == CONIC:
        return t, OK
    return newton(p[0], p[1], p[2], d[0], d[1], d[2], t, formulas, codes[s], terms)


@_jit
def _slopes_and_hessian(codes, formulas, s, terms, x, y):
    """Return the slopes of surface s along x and y, and its second derivatives xx, xy and yy."""
    if codes is None:
        _, by_x, by_y = shapes.conic_sag_and_gradient(terms, x, y)
        xx, xy, yy = shapes.conic_sag_hessian(terms, x, y)
    else:
        _, by_x, by_y = shapes.sag_and_gradient(formulas, codes[s], terms, x, y)
        xx, xy, yy = shapes.sag_hessian(formulas, codes[s], terms, x, y)
    return by_x, by_y, xx, xy, yy


@_jit
def _term_derivatives(codes, formulas, s, terms, j, x, y):
    """Return the derivatives of sag and slopes of surface s with respect to term j."""
    if codes is None:
        return shapes.conic_term_derivatives(terms, j, x, y)
    return shapes.term_derivatives(formulas, codes[s], terms, j, x, y)


@_jit
def _surface(p, d, dp, dd, vertex, codes, formulas, starts, terms, index, kind, surface_of, term, s):
    """Propagate a ray and its derivatives to surface s and refract them."""
    own = terms[s]
    p[2] -= vertex[s]
    t, outcome = _hit(p, d, codes, formulas, s, starts[s], own)
    if outcome != OK:
        return outcome
    for a in range(3):
        p[a] += t * d[a]
    by_x, by_y, sag_xx, sag_xy, sag_yy = _slopes_and_hessian(codes, formulas, s, own, p[0], p[1])
    nx, ny = -by_x, -by_y
    along = d[2] + nx * d[0] + ny * d[1]
    m2 = 1.0 + nx * nx + ny * ny
    m = math.sqrt(m2)
    mu = index[s] / index[s + 1]
    cos_in = along / m
    square = 1.0 - mu * mu * (1.0 - cos_in * cos_in)
    if square < 0.0:
        return TOTAL_REFLECTION
    if along == 0.0:
        return NOT_CONVERGED
    cos_out = math.sqrt(square)
    change = (cos_out - mu * cos_in) / m
    for j in range(kind.shape[0]):
        sag_j, by_x_j, by_y_j = 0.0, 0.0, 0.0
        if surface_of[j] == s and kind[j] == SHAPE:
            sag_j, by_x_j, by_y_j = _term_derivatives(codes, formulas, s, own, term[j], p[0], p[1])
        px = dp[0, j] + t * dd[0, j]
        py = dp[1, j] + t * dd[1, j]
        pz = dp[2, j] + t * dd[2, j] - _vertex_motion(kind[j], surface_of[j], s)
        dt = (sag_j - (nx * px + ny * py + pz)) / along
        px += dt * d[0]
        py += dt * d[1]
        pz += dt * d[2]
        dnx = -(sag_xx * px + sag_xy * py + by_x_j)
        dny = -(sag_xy * px + sag_yy * py + by_y_j)
        dm2 = 2.0 * (nx * dnx + ny * dny)
        dalong = dd[2, j] + dnx * d[0] + nx * dd[0, j] + dny * d[1] + ny * dd[1, j]
        dcos_in = dalong / m - 0.5 * cos_in * dm2 / m2
        dcos_out = mu * mu * cos_in * dcos_in / cos_out
        dchange = (dcos_out - mu * dcos_in) / m - 0.5 * change * dm2 / m2
        dp[0, j], dp[1, j] = px, py
        dp[2, j] = pz + _vertex_motion(kind[j], surface_of[j], s)
        dd[0, j] = mu * dd[0, j] + dchange * nx + change * dnx
        dd[1, j] = mu * dd[1, j] + dchange * ny + change * dny
        dd[2, j] = mu * dd[2, j] + dchange
    d[0] = mu * d[0] + change * nx
    d[1] = mu * d[1] + change * ny
    d[2] = mu * d[2] + change
    p[2] += vertex[s]
    return OK


@_jit
def _planes(p, d, dp, dd, last, planes, kind, surface_of, values, derivatives, i, surfaces):
    for q in range(planes.shape[0]):
        t = (last + planes[q] - p[2]) / d[2]
        slot = surfaces + 1 + q
        for a in range(2):
            values[i, slot, a] = p[a] + t * d[a]
        for j in range(kind.shape[0]):
            motion = _vertex_motion(kind[j], surface_of[j], surfaces - 1)
            dt = (motion - dp[2, j] - t * dd[2, j]) / d[2]
            for a in range(2):
                derivatives[i, slot, a, j] = dp[a, j] + t * dd[a, j] + dt * d[a]


drop_outdated(
    gradient_kernel,
    {__name__, kernel.__name__, conic_kernel.__name__, intersection.__name__} | shapes.SOURCES,
)

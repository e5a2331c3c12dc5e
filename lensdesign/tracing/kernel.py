"""The Numba ray kernel: trials x rays, in blocks that the compiler can vectorize.

Each block of rays lives in small local arrays, and each step is one loop without branches: a ray that
has failed is carried along and left unchanged. No fast-math, so NaN and statuses decide as written.
Conics are met in closed form, all other shapes by Newton's method from a conic near them.
"""

from __future__ import annotations

import math

import numpy as np

from lensdesign.lens.shapes import compiled as shapes
from lensdesign.lens.shapes import intersection
from lensdesign.lens.shapes.intersection import NEWTON_STEPS, RIM_TOLERANCE
from lensdesign.tracing.kept_kernels import drop_outdated, kept_njit

BLOCK = 128
X, Y, Z, L, M, N, OPL = range(0, 7 * BLOCK, BLOCK)
CONIC = 0
"""The registry's first shape."""

OK, MISSED, CLIPPED, TOTAL_REFLECTION, NOT_CONVERGED = range(5)

_jit = kept_njit(nogil=True, error_model="numpy")
_inline = kept_njit(nogil=True, error_model="numpy", inline="always")


@_jit
def trace_kernel(
    origins,
    directions,
    rotation,
    vertex,
    codes,
    starts,
    terms,
    figures,
    first_trial,
    index,
    semi_diameter,
    tilted,
    plane_z,
    use_plane,
    clip,
    position,
    direction,
    opl,
    status,
    failed,
    hits,
    first_ray,
    end_ray,
):
    """Trace some rays of all trials; origins and directions have shape (trials or 1, rays, 3).

    `codes`, `starts` and `terms` are what :class:`lensdesign.tracing.compiled.CompiledSystem` packs;
    `figures` are the arrays of :class:`lensdesign.lens.figure.PackedFigures`, in which these trials begin at
    `first_trial`. Without figures they are None, and `codes` too where all surfaces are conics: what a lens
    does not need is then not compiled.
    The six arrays from `position` on are filled for the rays from `first_ray` up to `end_ray`; `hits` may
    have no rays, and is then left alone. Returns the number of directions that are not finite unit vectors.
    """
    trials = status.shape[0]
    ray = np.empty(7 * BLOCK)
    state = np.empty(2 * BLOCK, np.int64)
    bad = 0
    for t in range(trials):
        to = t if origins.shape[0] > 1 else 0
        td = t if directions.shape[0] > 1 else 0
        tv = t if vertex.shape[0] > 1 else 0
        ts = t if terms.shape[0] > 1 else 0
        ti = t if index.shape[0] > 1 else 0
        for start in range(first_ray, end_ray, BLOCK):
            count = min(BLOCK, end_ray - start)
            bad += _load(ray, state, origins[to], directions[td], start, count)
            for s in range(vertex.shape[1]):
                if tilted[s]:
                    _to_local(ray, rotation[tv, s], vertex[tv, s], count)
                else:
                    _shift(ray, vertex[tv, s, 0], vertex[tv, s, 1], vertex[tv, s, 2], count)
                limit = (semi_diameter[s] * (1.0 + RIM_TOLERANCE)) ** 2 if clip else np.inf
                n1, n2 = index[ti, s], index[ti, s + 1]
                c, k = starts[ts, s, 0], starts[ts, s, 1]
                if codes is None:
                    _conic(ray, state, s, c, k, n1, n1 / n2, limit, count)
                elif codes[s] == CONIC and not _has_figure(figures, s):
                    _conic(ray, state, s, c, k, n1, n1 / n2, limit, count)
                else:
                    code, own, trial = codes[s], terms[ts, s], first_trial + t
                    _intersect_general(ray, state, s, code, c, k, own, n1, limit, count, figures, trial)
                    _refract_general(ray, state, s, code, own, n1 / n2, count, figures, trial)
                if tilted[s]:
                    _to_fixed(ray, rotation[tv, s], vertex[tv, s], count)
                else:
                    _shift(ray, -vertex[tv, s, 0], -vertex[tv, s, 1], -vertex[tv, s, 2], count)
                if hits.shape[1] > 0:
                    for i in range(count):
                        hits[t, start + i, s, 0] = ray[X + i]
                        hits[t, start + i, s, 1] = ray[Y + i]
                        hits[t, start + i, s, 2] = ray[Z + i]
            if use_plane:
                _to_plane(ray, state, vertex.shape[1], plane_z, index[ti, index.shape[1] - 1], count)
            _store(ray, state, position[t], direction[t], opl[t], status[t], failed[t], start, count)
    return bad


@_jit
def _has_figure(figures, surface):
    if figures is None:
        return False
    return figures[0][surface + 1] > figures[0][surface]


@_jit
def _load(ray, state, origins, directions, start, count):
    bad = 0
    for i in range(count):
        ray[X + i] = origins[start + i, 0]
        ray[Y + i] = origins[start + i, 1]
        ray[Z + i] = origins[start + i, 2]
        ray[L + i] = directions[start + i, 0]
        ray[M + i] = directions[start + i, 1]
        ray[N + i] = directions[start + i, 2]
    for i in range(count):
        ray[OPL + i] = 0.0
        state[i] = OK
        state[BLOCK + i] = -1
        norm = ray[L + i] * ray[L + i] + ray[M + i] * ray[M + i] + ray[N + i] * ray[N + i]
        where = ray[X + i] + ray[Y + i] + ray[Z + i]
        good = (abs(norm - 1.0) < 1e-6) & (where - where == 0.0)
        bad += 0 if good else 1
    return bad


@_jit
def _store(ray, state, position, direction, opl, status, failed, start, count):
    for i in range(count):
        position[start + i, 0] = ray[X + i]
        position[start + i, 1] = ray[Y + i]
        position[start + i, 2] = ray[Z + i]
        direction[start + i, 0] = ray[L + i]
        direction[start + i, 1] = ray[M + i]
        direction[start + i, 2] = ray[N + i]
    for i in range(count):
        opl[start + i] = ray[OPL + i]
        status[start + i] = state[i]
        failed[start + i] = state[BLOCK + i]


@_jit
def _shift(ray, dx, dy, dz, count):
    for i in range(count):
        ray[X + i] -= dx
        ray[Y + i] -= dy
        ray[Z + i] -= dz


@_jit
def _to_local(ray, r, v, count):
    for i in range(count):
        x, y, z = ray[X + i] - v[0], ray[Y + i] - v[1], ray[Z + i] - v[2]
        ray[X + i] = r[0, 0] * x + r[1, 0] * y + r[2, 0] * z
        ray[Y + i] = r[0, 1] * x + r[1, 1] * y + r[2, 1] * z
        ray[Z + i] = r[0, 2] * x + r[1, 2] * y + r[2, 2] * z
        x, y, z = ray[L + i], ray[M + i], ray[N + i]
        ray[L + i] = r[0, 0] * x + r[1, 0] * y + r[2, 0] * z
        ray[M + i] = r[0, 1] * x + r[1, 1] * y + r[2, 1] * z
        ray[N + i] = r[0, 2] * x + r[1, 2] * y + r[2, 2] * z


@_jit
def _to_fixed(ray, r, v, count):
    for i in range(count):
        x, y, z = ray[X + i], ray[Y + i], ray[Z + i]
        ray[X + i] = r[0, 0] * x + r[0, 1] * y + r[0, 2] * z + v[0]
        ray[Y + i] = r[1, 0] * x + r[1, 1] * y + r[1, 2] * z + v[1]
        ray[Z + i] = r[2, 0] * x + r[2, 1] * y + r[2, 2] * z + v[2]
        x, y, z = ray[L + i], ray[M + i], ray[N + i]
        ray[L + i] = r[0, 0] * x + r[0, 1] * y + r[0, 2] * z
        ray[M + i] = r[1, 0] * x + r[1, 1] * y + r[1, 2] * z
        ray[N + i] = r[2, 0] * x + r[2, 1] * y + r[2, 2] * z


@_jit
def _conic(ray, state, surface, c, k, n1, ratio, limit, count):
    """Intersect and refract at a plane, sphere or conic, in its own frame."""
    q = 1.0 + k
    for i in range(count):
        x, y, z = ray[X + i], ray[Y + i], ray[Z + i]
        dx, dy, dz = ray[L + i], ray[M + i], ray[N + i]
        qa = c * (1.0 + k * dz * dz)
        qb = dz - c * (x * dx + y * dy + q * z * dz)
        qc = c * (x * x + y * y + q * z * z) - 2.0 * z
        square = qb * qb - qa * qc
        root = math.sqrt(max(square, 0.0))
        stable = qb >= 0.0
        denominator = qb + root if stable else qa
        t = (qc if stable else qb - root) / (denominator if denominator != 0.0 else 1.0)
        x += t * dx
        y += t * dy
        z += t * dz
        upright = 1.0 - q * c * z
        r2 = x * x + y * y
        norm = 1.0 / math.sqrt(c * c * r2 + upright * upright)
        cos_in = (dz * upright - c * (x * dx + y * dy)) * norm
        square_out = 1.0 - ratio * ratio * (1.0 - cos_in * cos_in)
        bend = (math.sqrt(max(square_out, 0.0)) - ratio * cos_in) * norm

        alive = state[i] == OK
        hit = alive & (square >= 0.0) & (denominator != 0.0) & (upright > 0.0)
        inside = hit & (r2 <= limit)
        through = inside & (square_out >= 0.0)
        ray[X + i] = x if hit else ray[X + i]
        ray[Y + i] = y if hit else ray[Y + i]
        ray[Z + i] = z if hit else ray[Z + i]
        ray[OPL + i] += n1 * t if hit else 0.0
        ray[L + i] = ratio * dx - bend * c * x if through else dx
        ray[M + i] = ratio * dy - bend * c * y if through else dy
        ray[N + i] = ratio * dz + bend * upright if through else dz
        why = OK if through else (TOTAL_REFLECTION if inside else (CLIPPED if hit else MISSED))
        state[i] = why if alive else state[i]
        state[BLOCK + i] = surface if alive & (why != OK) else state[BLOCK + i]


@_inline
def _basis(at, nodes, per_mm):
    """Cell of a coordinate, the four B-splines there, and their slopes; the edge goes on outside."""
    u = at * per_mm + 0.5 * (nodes - 1)
    if u >= 0.0 and u <= nodes - 1:
        scale = per_mm
    else:
        scale = 0.0
        u = nodes - 1.0 if u > 0.0 else 0.0
    cell = min(int(u), nodes - 2)
    t = u - cell
    v = 1.0 - t
    values = (
        v * v * v / 6.0,
        (4.0 + t * t * (3.0 * t - 6.0)) / 6.0,
        (1.0 + t * (3.0 + t * (3.0 - 3.0 * t))) / 6.0,
        t * t * t / 6.0,
    )
    slopes = (
        -0.5 * scale * v * v,
        0.5 * scale * t * (3.0 * t - 4.0),
        0.5 * scale * (1.0 + t * (2.0 - 3.0 * t)),
        0.5 * scale * t * t,
    )
    return cell, values, slopes


@_jit
def _sag_error(x, y, surface, figures, trial):
    """Sag error of a surface, and its slopes along x and y."""
    first, layout, per_mm, coefficients = figures
    sag, by_x, by_y = 0.0, 0.0, 0.0
    for f in range(first[surface], first[surface + 1]):
        columns = layout[f, 3]
        i, vx, sx = _basis(x, columns - 2, per_mm[f])
        j, vy, sy = _basis(y, layout[f, 2] - 2, per_mm[f])
        at = layout[f, 0] + trial * layout[f, 1] + j * columns + i
        for row in range(4):
            c0, c1 = coefficients[at], coefficients[at + 1]
            c2, c3 = coefficients[at + 2], coefficients[at + 3]
            along = vx[0] * c0 + vx[1] * c1 + vx[2] * c2 + vx[3] * c3
            sag += vy[row] * along
            by_y += sy[row] * along
            by_x += vy[row] * (sx[0] * c0 + sx[1] * c1 + sx[2] * c2 + sx[3] * c3)
            at += columns
    return sag, by_x, by_y


@_inline
def _sag_and_slopes(x, y, code, terms, surface, figures, trial):
    """Sag of a surface, and its slopes along x and y; with its figure unless `figures` is None."""
    sag, by_x, by_y = shapes.height(code, terms, x, y)
    if figures is not None:
        error, error_x, error_y = _sag_error(x, y, surface, figures, trial)
        sag, by_x, by_y = sag + error, by_x + error_x, by_y + error_y
    return sag, by_x, by_y


@_jit
def conic_distance(x, y, z, dx, dy, dz, c, k):
    """Distance of a ray to a conic, and whether it meets it."""
    q = 1.0 + k
    qa = c * (1.0 + k * dz * dz)
    qb = dz - c * (x * dx + y * dy + q * z * dz)
    qc = c * (x * x + y * y + q * z * z) - 2.0 * z
    square = qb * qb - qa * qc
    if square < 0.0:
        return 0.0, False
    root = math.sqrt(square)
    stable = qb >= 0.0
    denominator = qb + root if stable else qa
    t = (qc if stable else qb - root) / denominator
    return t, denominator != 0.0 and 1.0 - q * c * (z + t * dz) > 0.0


@_jit
def _intersect_general(ray, state, surface, code, c, k, terms, n1, limit, count, figures, trial):
    """Move rays to a surface that is no conic, or has a figure, by Newton's method."""
    for i in range(count):
        if state[i] != OK:
            continue
        x, y, z = ray[X + i], ray[Y + i], ray[Z + i]
        dx, dy, dz = ray[L + i], ray[M + i], ray[N + i]
        why = MISSED
        t, near = conic_distance(x, y, z, dx, dy, dz, c, k)
        if near:
            t, why = newton(x, y, z, dx, dy, dz, t, code, terms, surface, figures, trial)
        if why == OK:
            x, y = x + t * dx, y + t * dy
            ray[X + i], ray[Y + i], ray[Z + i] = x, y, z + t * dz
            ray[OPL + i] += n1 * t
            if x * x + y * y > limit:
                why = CLIPPED
        if why != OK:
            state[i] = why
            state[BLOCK + i] = surface


@_jit
def newton(x, y, z, dx, dy, dz, t, code, terms, surface=-1, figures=None, trial=0):
    """Distance of a ray to a surface from a first guess, and what became of it."""
    settled_before = False
    for _ in range(NEWTON_STEPS):
        px, py = x + t * dx, y + t * dy
        sag, by_x, by_y = _sag_and_slopes(px, py, code, terms, surface, figures, trial)
        slope = dz - (by_x * dx + by_y * dy)
        step = (z + t * dz - sag) / slope
        if not (abs(step) < np.inf) or abs(slope) <= 1e-12:
            return t, MISSED
        t -= step
        settled = abs(step) <= 1e-14 * (1.0 + abs(t))
        if settled and settled_before:
            return t, OK if slope > 0.0 else MISSED
        settled_before = settled
    if not settled_before:
        return t, NOT_CONVERGED
    return t, OK if slope > 0.0 else MISSED


@_jit
def _refract_general(ray, state, surface, code, terms, ratio, count, figures, trial):
    for i in range(count):
        x, y = ray[X + i], ray[Y + i]
        dx, dy, dz = ray[L + i], ray[M + i], ray[N + i]
        _, by_x, by_y = _sag_and_slopes(x, y, code, terms, surface, figures, trial)
        nx, ny = -by_x, -by_y
        norm = 1.0 / math.sqrt(1.0 + nx * nx + ny * ny)
        cos_in = (dz + nx * dx + ny * dy) * norm
        square = 1.0 - ratio * ratio * (1.0 - cos_in * cos_in)
        bend = (math.sqrt(max(square, 0.0)) - ratio * cos_in) * norm
        alive = state[i] == OK
        through = alive & (square >= 0.0)
        ray[L + i] = ratio * dx + bend * nx if through else dx
        ray[M + i] = ratio * dy + bend * ny if through else dy
        ray[N + i] = ratio * dz + bend if through else dz
        state[i] = TOTAL_REFLECTION if alive & (not through) else state[i]
        state[BLOCK + i] = surface if alive & (not through) else state[BLOCK + i]


@_jit
def _to_plane(ray, state, surfaces, plane_z, n, count):
    for i in range(count):
        dz = ray[N + i]
        alive = state[i] == OK
        forward = alive & (dz > 0.0)
        t = (plane_z - ray[Z + i]) / (dz if dz != 0.0 else 1.0)
        ray[X + i] += t * ray[L + i] if forward else 0.0
        ray[Y + i] += t * ray[M + i] if forward else 0.0
        ray[Z + i] = plane_z if forward else ray[Z + i]
        ray[OPL + i] += n * t if forward else 0.0
        state[i] = MISSED if alive & (not forward) else state[i]
        state[BLOCK + i] = surfaces if alive & (not forward) else state[BLOCK + i]


drop_outdated(trace_kernel, {__name__, intersection.__name__} | shapes.SOURCES)

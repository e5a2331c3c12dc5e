"""The Numba ray kernel: trials x rays, in blocks that the compiler can vectorize.

Each block of rays is stored in small local arrays, and each step is one loop without branches. Fast-math is
off, so that comparisons with NaN work as written and no ray depends on its neighbours. Rays intersect conics
in closed form (`conic_kernel`), and other shapes by Newton's method from a conic near them (`shape_kernel`).
Rays through surfaces with a figure, and those that fail, are traced one by one.
"""

from __future__ import annotations

import math

import numpy as np

from lensdesign.lens.shapes import compiled as shapes
from lensdesign.lens.shapes import intersection
from lensdesign.lens.shapes.intersection import NEWTON_STEPS, RIM_TOLERANCE, ROUNDED_RESIDUAL, has_settled
from lensdesign.raytrace import conic_kernel, shape_kernel
from lensdesign.raytrace.cached_kernels import cached_njit, drop_outdated
from lensdesign.raytrace.conic_kernel import (
    BLOCK,
    CLIPPED,
    MISSED,
    NOT_CONVERGED,
    OK,
    OPL,
    TOTAL_REFLECTION,
    L,
    M,
    N,
    X,
    Y,
    Z,
    conic_distance,
    resolve_failures,
    restore_failed,
    through_conic,
    to_plane,
)
from lensdesign.raytrace.shape_kernel import is_vectorized, through_shape

CONIC = 0
"""Code of the conic, the first shape of the registry."""

_jit = cached_njit(nogil=True, error_model="numpy")
_inline = cached_njit(nogil=True, error_model="numpy", inline="always")

_has_settled = _inline(has_settled)


@_jit
def trace_kernel(
    origins,
    directions,
    rotation,
    vertex,
    codes,
    formulas,
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
    """Trace some rays of all trials.

    `origins`, `directions`, `position` and `direction` are flat, of shape (trials or 1, 3 rays): the compiler
    vectorizes accesses with the known stride 3.

    `codes`, `starts` and `terms` come from :class:`lensdesign.raytrace.compiled.CompiledSystem`. `figures`
    are the arrays of :class:`lensdesign.lens.surface_figure.PackedSurfaceFigures`, in which these trials
    begin at `first_trial`. `figures` is None without figures, `codes` is None if all surfaces are conics, and
    the type of `formulas` names the formulas that a lens needs: other code is not compiled. The six arrays
    from `position` on are filled for the rays from `first_ray` up to `end_ray`. `hits` may have no rays and
    is then not filled. Returns the number of rays whose origin is not finite or whose direction is not a
    finite unit vector.
    """
    trials, surfaces = status.shape[0], vertex.shape[1]
    ray, after = np.empty(7 * BLOCK), np.empty(7 * BLOCK)
    work = np.empty(3 * BLOCK)
    state = np.empty(2 * BLOCK, np.int64)
    failed_count, bad = BLOCK, 0
    for t in range(trials):
        to = t if origins.shape[0] > 1 else 0
        td = t if directions.shape[0] > 1 else 0
        tv = t if vertex.shape[0] > 1 else 0
        ts = t if terms.shape[0] > 1 else 0
        ti = t if index.shape[0] > 1 else 0
        for start in range(first_ray, end_ray, BLOCK):
            count = min(BLOCK, end_ray - start)
            at = slice(3 * start, 3 * (start + count))
            if failed_count > 0:  # in the previous block
                state[:BLOCK], state[BLOCK:] = OK, -1
                failed_count = 0
            bad += _load(ray, origins[to, at], directions[td, at], count)
            for s in range(surfaces):
                limit = (semi_diameter[s] * (1.0 + RIM_TOLERANCE)) ** 2 if clip else np.inf
                n1, n2 = index[ti, s], index[ti, s + 1]
                c, k = starts[ts, s, 0], starts[ts, s, 1]
                x0, y0, z0 = vertex[tv, s, 0], vertex[tv, s, 1], vertex[tv, s, 2]
                centred = not tilted[s] and x0 == 0.0 and y0 == 0.0
                if not centred:
                    _shift(ray, -x0, -y0, -z0, count)
                    z0 = 0.0
                if tilted[s]:
                    _rotate(ray, rotation[tv, s].T, count)
                if codes is None or (codes[s] == CONIC and not _has_figure(figures, s)):
                    uncertain = through_conic(ray, after, work, z0, c, k, n1, n1 / n2, limit, count)
                    if uncertain + failed_count > 0:
                        failed_count = resolve_failures(
                            ray, after, work, state, s, z0, c, k, n1 / n2, limit, count
                        )
                else:
                    code, own, trial = codes[s], terms[ts, s], first_trial + t
                    if _has_figure(figures, s) or not is_vectorized(formulas, code):
                        uncertain, work[:count] = count, -1.0
                    else:
                        uncertain = through_shape(
                            formulas, code, ray, after, work, z0, c, k, own, n1, n1 / n2, limit, count
                        )
                    if uncertain + failed_count > 0:
                        failed_count = _one_by_one(
                            ray,
                            after,
                            work,
                            state,
                            s,
                            z0,
                            formulas,
                            code,
                            c,
                            k,
                            own,
                            n1,
                            n1 / n2,
                            limit,
                            count,
                            figures,
                            trial,
                        )
                ray, after = after, ray
                if tilted[s]:
                    _rotate(ray, rotation[tv, s], count)
                if not centred:
                    _shift(ray, x0, y0, vertex[tv, s, 2], count)
                for i in range(count if hits.shape[1] > 0 else 0):
                    hits[t, start + i, s, 0] = ray[X + i]
                    hits[t, start + i, s, 1] = ray[Y + i]
                    hits[t, start + i, s, 2] = ray[Z + i]
            if use_plane:
                failed_count = to_plane(
                    ray, state, failed_count, surfaces, plane_z, index[ti, surfaces], count
                )
            _store(ray, position[t, at], direction[t, at], opl[t, start : start + count], count)
            _store_state(
                state, failed_count, status[t, start : start + count], failed[t, start : start + count]
            )
    return bad


@_jit
def _has_figure(figures, surface):
    if figures is None:
        return False
    return figures[0][surface + 1] > figures[0][surface]


@_jit
def _load(ray, origins, directions, count):
    """Load rays from flat arrays; return the number of invalid rays."""
    for i in range(count):
        ray[X + i], ray[Y + i], ray[Z + i] = origins[3 * i], origins[3 * i + 1], origins[3 * i + 2]
    bad = 0
    for i in range(count):
        dx, dy, dz = directions[3 * i], directions[3 * i + 1], directions[3 * i + 2]
        total = ray[X + i] + ray[Y + i] + ray[Z + i]
        off = abs(dx * dx + dy * dy + dz * dz - 1.0) + (total - total)  # NaN if the origin is not finite
        bad += 0 if off < 1e-6 else 1
        ray[L + i], ray[M + i], ray[N + i] = dx, dy, dz
        ray[OPL + i] = 0.0
    return bad


@_jit
def _store(ray, position, direction, opl, count):
    for i in range(count):
        position[3 * i], position[3 * i + 1], position[3 * i + 2] = ray[X + i], ray[Y + i], ray[Z + i]
    for i in range(count):
        direction[3 * i], direction[3 * i + 1], direction[3 * i + 2] = ray[L + i], ray[M + i], ray[N + i]
    for i in range(count):
        opl[i] = ray[OPL + i]


@_jit
def _store_state(state, failed_count, status, failed):
    if failed_count == 0:
        status[:], failed[:] = OK, -1
        return
    for i in range(len(status)):
        status[i] = state[i]
    for i in range(len(failed)):
        failed[i] = state[BLOCK + i]


@_jit
def _shift(ray, dx, dy, dz, count):
    for i in range(count):
        ray[X + i] += dx
        ray[Y + i] += dy
        ray[Z + i] += dz


@_jit
def _rotate(ray, r, count):
    xx, xy, xz = r[0, 0], r[0, 1], r[0, 2]
    yx, yy, yz = r[1, 0], r[1, 1], r[1, 2]
    zx, zy, zz = r[2, 0], r[2, 1], r[2, 2]
    for i in range(count):
        x, y, z = ray[X + i], ray[Y + i], ray[Z + i]
        ray[X + i] = xx * x + xy * y + xz * z
        ray[Y + i] = yx * x + yy * y + yz * z
        ray[Z + i] = zx * x + zy * y + zz * z
    for i in range(count):
        x, y, z = ray[L + i], ray[M + i], ray[N + i]
        ray[L + i] = xx * x + xy * y + xz * z
        ray[M + i] = yx * x + yy * y + yz * z
        ray[N + i] = zx * x + zy * y + zz * z


@_inline
def _basis(at, nodes, per_mm):
    """Return the cell of a coordinate and the four B-splines there with slopes; constant outside the grid."""
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
    """Return the sag error of a surface and its slopes along x and y."""
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
def _sag_and_slopes(x, y, formulas, code, terms, surface, figures, trial):
    """Return the sag of a surface and its slopes along x and y, with its figure unless `figures` is None."""
    sag, by_x, by_y = shapes.sag_and_gradient(formulas, code, terms, x, y)
    if figures is not None:
        error, error_x, error_y = _sag_error(x, y, surface, figures, trial)
        sag, by_x, by_y = sag + error, by_x + error_x, by_y + error_y
    return sag, by_x, by_y


@_jit
def _one_by_one(
    ray, after, work, state, surface, z0, formulas, code, c, k, terms, n1, ratio, limit, count, figures, trial
):
    """Trace the rays of a block whose margin in `work` is not above 0, one by one, and put failed rays back.

    Returns the number of failed rays.
    """
    for i in range(count):
        if state[i] != OK or work[i] > 0.0:
            continue
        x, y, z = ray[X + i], ray[Y + i], ray[Z + i] - z0
        dx, dy, dz = ray[L + i], ray[M + i], ray[N + i]
        outcome = MISSED
        t, hit = conic_distance(x, y, z, dx, dy, dz, c, k)
        if hit:
            t, outcome = newton(x, y, z, dx, dy, dz, t, formulas, code, terms, surface, figures, trial)
        if outcome == OK:
            x, y = x + t * dx, y + t * dy
            ray[X + i], ray[Y + i], ray[Z + i] = x, y, ray[Z + i] + t * dz
            ray[OPL + i] += n1 * t
            if x * x + y * y > limit:
                outcome = CLIPPED
        if outcome == OK:
            _, by_x, by_y = _sag_and_slopes(x, y, formulas, code, terms, surface, figures, trial)
            norm = 1.0 / math.sqrt(1.0 + by_x * by_x + by_y * by_y)
            cos_in = (dz - by_x * dx - by_y * dy) * norm
            square = 1.0 - ratio * ratio * (1.0 - cos_in * cos_in)
            if square < 0.0:
                outcome = TOTAL_REFLECTION
            else:
                bend = (math.sqrt(square) - ratio * cos_in) * norm
                for q in (X, Y, Z, OPL):
                    after[q + i] = ray[q + i]
                after[L + i] = ratio * dx - bend * by_x
                after[M + i] = ratio * dy - bend * by_y
                after[N + i] = ratio * dz + bend
        if outcome != OK:
            state[i] = outcome
            state[BLOCK + i] = surface
    return restore_failed(ray, after, state, count)


@_jit
def newton(x, y, z, dx, dy, dz, t, formulas, code, terms, surface=-1, figures=None, trial=0):
    """Return the distance of a ray to a surface from a first guess, and the status of the ray."""
    before = 0.0
    for _ in range(NEWTON_STEPS):
        px, py = x + t * dx, y + t * dy
        sag, by_x, by_y = _sag_and_slopes(px, py, formulas, code, terms, surface, figures, trial)
        slope = dz - (by_x * dx + by_y * dy)
        residual = z + t * dz - sag
        step = residual / slope
        if not (abs(step) < np.inf) or abs(slope) <= 1e-12:
            return t, MISSED
        t -= step
        if _has_settled(step, before, t):
            return t, OK if slope > 0.0 else MISSED
        before = step
    if abs(residual) > ROUNDED_RESIDUAL * (1.0 + abs(t)):
        return t, NOT_CONVERGED
    return t, OK if slope > 0.0 else MISSED


drop_outdated(
    trace_kernel,
    {__name__, conic_kernel.__name__, shape_kernel.__name__, intersection.__name__} | shapes.SOURCES,
)

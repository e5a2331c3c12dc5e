"""Steps of the ray kernel in closed form: refraction at a conic, and propagation to a plane.

:func:`through_conic` traces a block of rays from one array to another as if no ray failed, in loops without
branches that the compiler vectorizes. It stores a margin for each ray and counts the rays whose margin is not
above 0. If there are any, or rays that failed before, :func:`resolve_failures` finds the reason for each.
Rays that miss keep their values; those that are clipped or totally reflected end on the surface with the
direction that they had.

In all functions `c` and `k` are curvature and conic constant, `z0` is the vertex of the surface, `n1` the
index in front of it, `ratio` that index over the one behind, and `limit` the squared semi-diameter. The
arrays `ray` and `after` hold the coordinates before and behind the surface, a block of each coordinate after
the other. `state` holds a status and a surface for each ray.
"""

from __future__ import annotations

import math

from lensdesign.raytrace.cached_kernels import cached_njit

BLOCK = 128
X, Y, Z, L, M, N, OPL = range(0, 7 * BLOCK, BLOCK)
OK, MISSED, CLIPPED, TOTAL_REFLECTION, NOT_CONVERGED = range(5)

_jit = cached_njit(nogil=True, error_model="numpy")
_inline = cached_njit(nogil=True, error_model="numpy", inline="always")


@_inline
def intersect_conic(x, y, z, dx, dy, dz, c, k):
    """Return the distance of a ray to a conic, and the discriminant, which is negative if the ray misses.

    The root of the discriminant is the product of the ray direction and the conic's normal
    (-c x, -c y, 1 - (1 + k) c z).
    """
    q = 1.0 + k
    qa = c * (1.0 + k * dz * dz)
    qb = dz - c * (x * dx + y * dy + q * z * dz)
    qc = c * (x * x + y * y + q * z * z) - 2.0 * z
    square = qb * qb - qa * qc
    root = math.sqrt(square)
    stable = qb >= 0.0
    t = (qc if stable else qb - root) / (qb + root if stable else qa)
    return t, square


@_inline
def _normal(x, y, z, c, k, ratio, square):
    """Return quantities of the normal at a point on a conic.

    They are the squared distance to the axis, the normal's z, its squared length, and the squared product of
    the normal and the refracted direction, which is negative in total reflection.
    """
    normal_z = 1.0 - (1.0 + k) * c * z
    r2 = x * x + y * y
    normal2 = c * c * r2 + normal_z * normal_z
    return r2, normal_z, normal2, normal2 * (1.0 - ratio * ratio) + ratio * ratio * square


@_jit
def conic_distance(x, y, z, dx, dy, dz, c, k):
    """Return the distance of a ray to a conic, and whether they intersect."""
    t, square = intersect_conic(x, y, z, dx, dy, dz, c, k)
    if not (square >= 0.0 and abs(t) < math.inf):
        return 0.0, False
    return t, 1.0 - (1.0 + k) * c * (z + t * dz) > 0.0


@_jit
def through_conic(ray, after, work, z0, c, k, n1, ratio, limit, count):
    """Intersect and refract at a plane, sphere or conic with its vertex on the axis, at z0.

    The margins are stored in the first third of `work`. Returns the number of margins that are not above 0.
    Three short loops are faster than a long one, in which the processor waits for roots and quotients.
    """
    uncertain = 0
    for i in range(count):
        x, y, z = ray[X + i], ray[Y + i], ray[Z + i] - z0
        t, square = intersect_conic(x, y, z, ray[L + i], ray[M + i], ray[N + i], c, k)
        work[i] = square
        work[BLOCK + i] = t
        work[2 * BLOCK + i] = ratio * math.sqrt(square)
    for i in range(count):
        square, t = work[i], work[BLOCK + i]
        x = ray[X + i] + t * ray[L + i]
        y = ray[Y + i] + t * ray[M + i]
        z = ray[Z + i] - z0 + t * ray[N + i]
        r2, normal_z, normal2, square_out = _normal(x, y, z, c, k, ratio, square)
        gain = (math.sqrt(square_out) - work[2 * BLOCK + i]) / normal2
        within = limit - r2
        least = normal_z if normal_z < within else within
        least = least if least < square_out else square_out  # NaN is chosen, too: such a ray has failed
        uncertain += 0 if least > 0.0 else 1
        after[X + i] = x
        after[Y + i] = y
        after[Z + i] = z + z0
        after[OPL + i] = ray[OPL + i] + n1 * t
        work[i] = least
        work[BLOCK + i] = gain * c
        work[2 * BLOCK + i] = gain * normal_z
    for i in range(count):
        after[L + i] = ratio * ray[L + i] - work[BLOCK + i] * after[X + i]
        after[M + i] = ratio * ray[M + i] - work[BLOCK + i] * after[Y + i]
        after[N + i] = ratio * ray[N + i] + work[2 * BLOCK + i]
    return uncertain


@_jit
def resolve_failures(ray, after, work, state, surface, z0, c, k, ratio, limit, count):
    """Set the status of rays that failed at a conic, put failed rays back, and return their number."""
    for i in range(count):
        if state[i] != OK or work[i] > 0.0:
            continue
        x, y, z = ray[X + i], ray[Y + i], ray[Z + i] - z0
        dx, dy, dz = ray[L + i], ray[M + i], ray[N + i]
        t, square = intersect_conic(x, y, z, dx, dy, dz, c, k)
        x, y, z = x + t * dx, y + t * dy, z + t * dz
        r2, normal_z, _, square_out = _normal(x, y, z, c, k, ratio, square)
        if not (square >= 0.0 and abs(t) < math.inf and normal_z > 0.0):
            state[i] = MISSED
        elif r2 > limit:
            state[i] = CLIPPED
        elif square_out < 0.0:
            state[i] = TOTAL_REFLECTION
        else:  # the margin is exactly 0: the ray passes
            continue
        state[BLOCK + i] = surface
        if state[i] != MISSED:
            ray[X + i], ray[Y + i], ray[Z + i] = x, y, z + z0
            ray[OPL + i] = after[OPL + i]
    return restore_failed(ray, after, state, count)


@_jit
def restore_failed(ray, after, state, count):
    """Restore the previous values of rays that failed, and return their number."""
    failed = 0
    for i in range(count):
        failed += 0 if state[i] == OK else 1
    for q in range(7):
        old, new = ray[q * BLOCK : q * BLOCK + count], after[q * BLOCK : q * BLOCK + count]
        for i in range(count):
            a, b = new[i], old[i]
            new[i] = a if state[i] == OK else b
    return failed


@_jit
def to_plane(ray, state, failed, surfaces, plane_z, n, count):
    """Propagate rays to a plane perpendicular to the axis; return 0 only if no ray has failed.

    `failed` is the number of rays that failed before.
    """
    for i in range(count):
        failed += 0 if ray[N + i] > 0.0 else 1
    if failed == 0:
        for i in range(count):
            t = (plane_z - ray[Z + i]) / ray[N + i]
            ray[X + i] += t * ray[L + i]
            ray[Y + i] += t * ray[M + i]
            ray[Z + i] = plane_z
            ray[OPL + i] += n * t
        return 0
    for i in range(count):
        x, y, z, path, status = ray[X + i], ray[Y + i], ray[Z + i], ray[OPL + i], state[i]
        failed_surface, dz = state[BLOCK + i], ray[N + i]
        forward = (status == OK) & (dz > 0.0)
        backward = (status == OK) & (not dz > 0.0)
        t = (plane_z - z) / dz
        ray[X + i] = x + t * ray[L + i] if forward else x
        ray[Y + i] = y + t * ray[M + i] if forward else y
        ray[Z + i] = plane_z if forward else z
        ray[OPL + i] = path + n * t if forward else path
        state[i] = MISSED if backward else status
        state[BLOCK + i] = surfaces if backward else failed_surface
    return failed

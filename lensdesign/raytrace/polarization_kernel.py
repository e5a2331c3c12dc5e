"""The compiled chain of Jones matrices along rays; see :mod:`lensdesign.raytrace.polarization`."""

from __future__ import annotations

import math

from lensdesign.raytrace.cached_kernels import cached_njit

_jit = cached_njit(nogil=True, error_model="numpy")


@_jit
def chain_jones(headings, normals, along_s, along_p, result):
    """Fill the Jones matrices of rays, shape (n, 2, 2).

    `headings` (n, surfaces + 1, 3) are the directions of the light, `normals` (n, surfaces, 3) those of the
    surfaces, `along_s` and `along_p` (n, surfaces) the coefficients of both polarizations.
    """
    for r in range(len(headings)):
        # Both fields of the basis are carried through all surfaces.
        ux, uy, uz, vx, vy, vz = _basis(headings[r, 0])
        e0x, e0y, e0z = complex(ux), complex(uy), complex(uz)
        e1x, e1y, e1z = complex(vx), complex(vy), complex(vz)
        for i in range(normals.shape[1]):
            kx, ky, kz = headings[r, i, 0], headings[r, i, 1], headings[r, i, 2]
            mx, my, mz = headings[r, i + 1, 0], headings[r, i + 1, 1], headings[r, i + 1, 2]
            nx, ny, nz = normals[r, i, 0], normals[r, i, 1], normals[r, i, 2]
            sx, sy, sz = ky * nz - kz * ny, kz * nx - kx * nz, kx * ny - ky * nx
            size = math.sqrt(sx * sx + sy * sy + sz * sz)
            if size > 1e-12:
                sx, sy, sz = sx / size, sy / size, sz / size
            else:  # at normal incidence, any vector across the ray
                sx, sy, sz, _, _, _ = _basis(headings[r, i])
            px, py, pz = ky * sz - kz * sy, kz * sx - kx * sz, kx * sy - ky * sx
            qx, qy, qz = my * sz - mz * sy, mz * sx - mx * sz, mx * sy - my * sx
            cs, cp = along_s[r, i], along_p[r, i]
            a, b = cs * (e0x * sx + e0y * sy + e0z * sz), cp * (e0x * px + e0y * py + e0z * pz)
            e0x, e0y, e0z = a * sx + b * qx, a * sy + b * qy, a * sz + b * qz
            a, b = cs * (e1x * sx + e1y * sy + e1z * sz), cp * (e1x * px + e1y * py + e1z * pz)
            e1x, e1y, e1z = a * sx + b * qx, a * sy + b * qy, a * sz + b * qz
        ux, uy, uz, vx, vy, vz = _basis(headings[r, -1])
        result[r, 0, 0] = e0x * ux + e0y * uy + e0z * uz
        result[r, 1, 0] = e0x * vx + e0y * vy + e0z * vz
        result[r, 0, 1] = e1x * ux + e1y * uy + e1z * uz
        result[r, 1, 1] = e1x * vx + e1y * vy + e1z * vz


@_jit
def _basis(direction):
    """Return both unit vectors of the double-pole basis of a direction."""
    a, b, c = direction[0], direction[1], direction[2]
    shared = 1.0 / (1.0 + c) if c > -1.0 else 0.0
    mixed = -a * b * shared
    return 1.0 - a * a * shared, mixed, -a, mixed, 1.0 - b * b * shared, -b

"""Which triangles of a mesh hang together, and whether they bound bodies."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from lensdesign.manufacture.mesh.reading import TriangleMesh

Indices = NDArray[np.int64]

MOST_AT_ONE_EDGE = 64
"""Triangles whose order round an edge is looked at; more are taken for one body."""

SAME_ANGLE = 0.1
"""In radians: where bodies touch their facets may be cut along other diagonals, and cross by a little."""


def merged(mesh: TriangleMesh) -> tuple[Array, Indices]:
    """Vertices, those at the same point as one, and faces, without those that are a line or a point."""
    vertices = mesh.vertices_mm + 0.0  # no -0, which has other bits than 0
    keys = np.ascontiguousarray(vertices).view([("", np.uint64)] * 3).ravel()
    _, first, inverse = np.unique(keys, return_index=True, return_inverse=True)
    faces = inverse.reshape(-1)[mesh.faces]
    whole = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    return vertices[first], faces[whole]


def closed_bodies(vertices: Array, faces: Indices) -> tuple[int, int]:
    """Number of bodies, and of edges at which triangles have no counterpart.

    Triangles hang together where they meet at an edge. Where bodies touch, and four or more meet there, each
    goes with the next one that bounds the same glass: the one behind it as one turns into the glass.

    Parameters
    ----------
    vertices, faces
        As :func:`merged` gives them; triangles run anticlockwise as seen from outside.

    Returns
    -------
    bodies, open_edges : int
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    if not len(faces):
        return 0, 0
    starts, ends = faces.T.reshape(-1), faces[:, [1, 2, 0]].T.reshape(-1)
    forward = starts < ends
    face = np.tile(np.arange(len(faces)), 3)
    apex = faces[:, [2, 0, 1]].T.reshape(-1)
    key = np.minimum(starts, ends) * len(vertices) + np.maximum(starts, ends)
    order = np.argsort(key, kind="stable")
    _, first, counts = np.unique(key[order], return_index=True, return_counts=True)
    balance = np.add.reduceat(np.where(forward[order], 1, -1), first)
    pairs = []
    for count in np.unique(counts):
        at = order[first[counts == count][:, None] + np.arange(count)]
        if count <= 2 or count > MOST_AT_ONE_EDGE:
            pairs += [face[at[:, [0, i]]] for i in range(1, count)]
        else:
            pairs.append(_round_edges(vertices, at, starts, ends, apex, forward, face))
    links = np.concatenate([np.empty((0, 2), np.int64), *pairs])
    graph = coo_array((np.ones(len(links), bool), (links[:, 0], links[:, 1])), shape=(len(faces),) * 2)
    return int(connected_components(graph, directed=False)[0]), int(np.count_nonzero(balance))


def _round_edges(
    vertices: Array,
    at: Indices,
    starts: Indices,
    ends: Indices,
    apex: Indices,
    forward: NDArray[np.bool_],
    face: Indices,
) -> Indices:
    """Pairs of triangles that bound the same glass, at edges with as many of them: `at`, shape (edges, n)."""
    low, high = np.minimum(starts, ends)[at[:, 0]], np.maximum(starts, ends)[at[:, 0]]
    axis = vertices[high] - vertices[low]
    arms = vertices[apex[at]] - vertices[low][:, None]
    along = axis / np.maximum(np.linalg.norm(axis, axis=1, keepdims=True), 1e-300)
    first = np.cross(along, arms[:, 0])
    first /= np.maximum(np.linalg.norm(first, axis=1, keepdims=True), 1e-300)
    second = np.cross(along, first)
    angle = np.arctan2(np.einsum("eni,ei->en", arms, second), np.einsum("eni,ei->en", arms, first))
    # Of a triangle that runs along the axis, the glass lies towards smaller angles.
    turn = (angle[:, :, None] - angle[:, None, :]) % (2.0 * np.pi)
    turn[turn < SAME_ANGLE] = 2.0 * np.pi
    runs = forward[at]
    turn[~(runs[:, :, None] & ~runs[:, None, :])] = np.inf
    partner = np.argmin(turn, axis=2)
    rows, columns = np.nonzero(np.isfinite(np.min(turn, axis=2)))
    return np.stack([face[at[rows, columns]], face[at[rows, partner[rows, columns]]]], axis=-1)

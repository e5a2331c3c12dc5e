"""Mesh files of whatever origin: STL, PLY, OBJ and 3MF, read without trust in what they say of themselves.

Counts in headers are held against the size of the file before anything is allocated, and nothing that a file
names is opened. Lengths are taken as mm where a format has no unit (all but 3MF).
"""

from __future__ import annotations

import os
from array import array
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.input_files import MESH_BYTES, TABLE_BYTES, read_input
from lensdesign.errors import InputError

MOST_TRIANGLES = 20_000_000

MOST_MM = 1e6
"""Largest coordinate: what lies farther out is no lens, and its squares lose their digits."""

LONGEST_LINE = 10_000

_STL_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_STL_HEADER = 84


@dataclass(frozen=True)
class TriangleMesh:
    """Triangles as a file has them.

    Attributes
    ----------
    vertices_mm
        Shape (n, 3).
    faces
        Indices of the corners of each triangle, anticlockwise from outside, shape (m, 3).
    """

    vertices_mm: NDArray[np.float64]
    faces: NDArray[np.int64]


def read_mesh(path: str | os.PathLike[str]) -> TriangleMesh:
    """Read a mesh file.

    Parameters
    ----------
    path
        A ``.stl`` (binary or text), ``.ply`` (text or binary), ``.obj`` or ``.3mf`` file of at most 1 GB (256
        MB if it is text or packed) and 20 million triangles. Polygons of an OBJ file are cut into triangles.

    Returns
    -------
    TriangleMesh

    Raises
    ------
    InputError
        If the suffix is unknown, the file is no regular one, is too large, cut short or malformed, or holds
        no triangle; the message names the file, and the line or element where it can.
    """
    from lensdesign.fabrication.mesh.ply import read_ply
    from lensdesign.fabrication.mesh.three_mf import read_three_mf

    readers: dict[str, Callable[[bytes], TriangleMesh]] = {
        ".stl": _read_stl,
        ".ply": read_ply,
        ".obj": _read_obj,
        ".3mf": read_three_mf,
    }
    suffix = Path(path).suffix.lower()
    if suffix not in readers:
        raise InputError(f"cannot read {path}: unknown suffix {suffix!r}; allowed: {', '.join(readers)}")
    data = read_input(path, MESH_BYTES if suffix in (".stl", ".ply") else TABLE_BYTES)
    try:
        return _checked(readers[suffix](data))
    except InputError as error:
        raise InputError(f"cannot read {path}: {error}") from error


def _checked(mesh: TriangleMesh) -> TriangleMesh:
    count = len(mesh.vertices_mm)
    if not len(mesh.faces):
        raise InputError("no triangle in it")
    if not np.all(np.isfinite(mesh.vertices_mm)):
        raise InputError("a coordinate is no finite number")
    largest = float(np.max(np.abs(mesh.vertices_mm)))
    if largest > MOST_MM:
        raise InputError(f"a coordinate of {largest:.3g} mm; at most {MOST_MM:g} can belong to a lens")
    if mesh.faces.min() < 0 or mesh.faces.max() >= count:
        raise InputError(f"a triangle has a vertex that does not exist; there are {count}")
    return mesh


def refuse_count(triangles: int) -> None:
    """Refuse more triangles than are read."""
    if triangles > MOST_TRIANGLES:
        raise InputError(f"{triangles} triangles; at most {MOST_TRIANGLES} are read")


def text_lines(data: bytes) -> Iterator[tuple[str, list[bytes]]]:
    """Where each line of a text stands, and its words; a line has at most 10,000 bytes."""
    if len(data) > TABLE_BYTES:
        raise InputError(f"{len(data)} bytes; at most {TABLE_BYTES} of text are read")
    for number, line in enumerate(data.replace(b"\r\n", b"\n").replace(b"\r", b"\n").split(b"\n"), start=1):
        if len(line) > LONGEST_LINE:
            raise InputError(f"line {number}: {len(line)} bytes; a line has at most {LONGEST_LINE}")
        yield f"line {number}", line.split()


def coordinates(words: list[bytes], where: str) -> list[float]:
    """Three numbers at the start of a line."""
    try:
        values = [float(word) for word in words[:3]]
    except ValueError:
        values = []
    if len(values) < 3 or any(b"_" in word for word in words[:3]):
        said = b" ".join(words)[:40].decode("ascii", "replace")
        raise InputError(f"{where}: {said!r} stands where three coordinates must")
    return values


def _read_stl(data: bytes) -> TriangleMesh:
    count = int.from_bytes(data[80:_STL_HEADER], "little")
    if len(data) < _STL_HEADER or len(data) != _STL_HEADER + count * _STL_TRIANGLE.itemsize:
        if data[:512].lstrip()[:5].lower() == b"solid":
            return _read_stl_text(data)
        raise InputError(
            f"{len(data)} bytes, where its header promises {count} triangles in "
            f"{_STL_HEADER + count * _STL_TRIANGLE.itemsize} bytes"
        )
    refuse_count(count)
    corners = np.frombuffer(data, _STL_TRIANGLE, count, _STL_HEADER)["corners"]
    with np.errstate(invalid="ignore"):  # signalling NaNs, which are refused by and by
        vertices = corners.reshape(-1, 3).astype(float)
    return TriangleMesh(vertices, np.arange(3 * count).reshape(-1, 3))


def _read_stl_text(data: bytes) -> TriangleMesh:
    values = array("d")
    facets, word = 0, b""
    for where, words in text_lines(data):
        if not words:
            continue
        word = words[0].lower()
        if word == b"facet":
            facets += 1
        elif word == b"vertex":
            values.extend(coordinates(words[1:], where))
        elif word == b"endfacet" and len(values) != 9 * facets:
            raise InputError(f"{where}: a facet without three corners")
    if word != b"endsolid" or len(values) != 9 * facets:
        raise InputError("text without endsolid behind its facets; is the file cut short?")
    return TriangleMesh(np.array(values).reshape(-1, 3), np.arange(3 * facets).reshape(-1, 3))


def _read_obj(data: bytes) -> TriangleMesh:
    """Vertices and faces; materials, textures, normals and groups say nothing of the shape."""
    values, faces = array("d"), array("q")
    for where, words in text_lines(data):
        if not words:
            continue
        if words[0] == b"v":
            values.extend(coordinates(words[1:], where))
        elif words[0] == b"f":
            corners = [_obj_index(word, len(values) // 3, where) for word in words[1:]]
            if len(corners) < 3:
                raise InputError(f"{where}: a face of {len(corners)} corners")
            for second, third in pairwise(corners[1:]):
                faces.extend((corners[0], second, third))
            refuse_count(len(faces) // 3)
    if b"\0" in data:
        raise InputError("not a text file")
    return TriangleMesh(
        np.array(values, float).reshape(-1, 3), np.array(faces, dtype=np.int64).reshape(-1, 3)
    )


def _obj_index(word: bytes, known: int, where: str) -> int:
    """Index from 0 of a corner such as 7, 7/2/3 or -1; only vertices that stand before it are known."""
    text = word.partition(b"/")[0]
    digits = text.removeprefix(b"-")
    index = int(text) if digits.isdigit() and len(digits) < 12 else 0
    if not 0 < abs(index) <= known:
        said = word[:40].decode("ascii", "replace")
        raise InputError(f"{where}: face corner {said!r}, with {known} vertices before it")
    return index - 1 if index > 0 else known + index

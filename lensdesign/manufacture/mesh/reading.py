"""Mesh files of whatever origin, read without trust in what they say of themselves.

STL, PLY and 3MF are read by trimesh. What a file promises is held against bounds before, and against what
came of it behind: of a text that was cut short trimesh takes what is left, in silence. OBJ is read here:
trimesh counts indices from the end of the file where they count from their own line. Nothing that a file
names is opened. Lengths are taken as mm where a format has no unit (all but 3MF).
"""

from __future__ import annotations

import io
import logging
import os
import re
import warnings
import zipfile
from array import array
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.input_files import MESH_BYTES, TABLE_BYTES, read_input
from lensdesign.errors import InputError

Triangles = tuple[NDArray[np.float64], NDArray[np.int64]]

# What trimesh would tell the terminal of a damaged file, tracebacks and all, our own message says.
logging.getLogger("trimesh").addHandler(logging.NullHandler())

MOST_TRIANGLES = 20_000_000

MOST_MM = 1e6
"""Largest coordinate: what lies farther out is no lens, and its squares lose their digits."""

LONGEST_HEADER = 65536
"""Of a PLY file."""

MOST_ENTRIES = 1000
"""Of a 3MF archive."""

MOST_PLACED = 10_000
"""Objects that a 3MF file places: ten components in ten levels would be ten billion."""

UNITS_MM = {
    "micron": 1e-3,
    "millimeter": 1.0,
    "centimeter": 10.0,
    "inch": 25.4,
    "foot": 304.8,
    "meter": 1000.0,
}


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
        MB if it is OBJ or 3MF) and 20 million triangles. Polygons are cut into triangles.

    Returns
    -------
    TriangleMesh

    Raises
    ------
    InputError
        If the suffix is unknown, the file is no regular one, is too large, cut short or malformed, or holds
        no triangle; the message names the file.
    """
    readers: dict[str, Callable[[bytes], Triangles]] = {
        ".stl": _stl_triangles,
        ".ply": _ply_triangles,
        ".obj": _obj_triangles,
        ".3mf": _three_mf_triangles,
    }
    suffix = Path(path).suffix.lower()
    if suffix not in readers:
        raise InputError(f"cannot read {path}: unknown suffix {suffix!r}; allowed: {', '.join(readers)}")
    data = read_input(path, MESH_BYTES if suffix in (".stl", ".ply") else TABLE_BYTES)
    try:
        return _checked(*readers[suffix](data))
    except InputError as error:
        raise InputError(f"cannot read {path}: {error}") from error
    except Exception as error:  # whatever a parser stumbles over
        said = f"no {suffix[1:].upper()} file, or a damaged one: {str(error)[:200]}"
        raise InputError(f"cannot read {path}: {said}") from error


def _checked(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> TriangleMesh:
    if not len(faces):
        raise InputError("no triangle in it")
    if not np.all(np.isfinite(vertices)):
        raise InputError("a coordinate is no finite number")
    largest = float(np.max(np.abs(vertices)))
    if largest > MOST_MM:
        raise InputError(f"a coordinate of {largest:.3g} mm; at most {MOST_MM:g} can belong to a lens")
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise InputError(f"a triangle has a vertex that does not exist; there are {len(vertices)}")
    return TriangleMesh(vertices, faces)


def _refuse_count(triangles: int) -> None:
    if triangles > MOST_TRIANGLES:
        raise InputError(f"{triangles} triangles; at most {MOST_TRIANGLES} are read")


def _stl_triangles(data: bytes) -> Triangles:
    count = int.from_bytes(data[80:84], "little")
    if len(data) != 84 + 50 * count:
        if data[:512].lstrip()[:5].lower() != b"solid":
            raise InputError(
                f"{len(data)} bytes; {count} triangles, as its header has, are {84 + 50 * count}"
            )
        count = len(re.findall(rb"^\s*facet\b", data, re.MULTILINE | re.IGNORECASE))
    return _by_trimesh(data, "stl", count)


def _ply_triangles(data: bytes) -> Triangles:
    if data.find(b"end_header", 0, LONGEST_HEADER) < 0:
        raise InputError(f"no PLY file: end_header must come within {LONGEST_HEADER} bytes")
    found = re.findall(rb"^element (\w+) (\d{1,18})\s", data[:LONGEST_HEADER], re.MULTILINE)
    rows = {name: int(count) for name, count in found}
    most = max(rows.values(), default=0)
    if most > len(data):
        raise InputError(f"{most} rows promised, in {len(data)} bytes")
    return _by_trimesh(data, "ply", rows.get(b"face", 0), skip_materials=True)


def _by_trimesh(data: bytes, kind: str, promised: int, **options: bool) -> Triangles:
    """Triangles of a file that has at least as many of them as promised."""
    import trimesh

    _refuse_count(promised)
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        # Older releases of NumPy only warn of a text that is no number, and leave out what follows.
        warnings.filterwarnings("error", "string or file could not be read", DeprecationWarning)
        mesh = trimesh.load_mesh(io.BytesIO(data), file_type=kind, process=False, **options)
    if len(mesh.faces) < promised:
        raise InputError(f"{promised} faces promised, {len(mesh.faces)} found; is the file cut short?")
    return np.array(mesh.vertices, float), np.array(mesh.faces, np.int64)


def _three_mf_triangles(data: bytes) -> Triangles:
    if data.count(b"PK\x01\x02") > MOST_ENTRIES:
        raise InputError(f"an archive of more than {MOST_ENTRIES} entries")
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        entries = archive.infolist()
        for entry in entries:
            parts = entry.filename.replace("\\", "/").split("/")
            if not parts[0] or ".." in parts or ":" in parts[0]:
                raise InputError(f"an archive with the path {entry.filename[:60]!r}, which leads out of it")
        unpacked = sum(entry.file_size for entry in entries)
        if unpacked > TABLE_BYTES:
            raise InputError(f"an archive of {unpacked} bytes; at most {TABLE_BYTES} are unpacked")
        models = [entry for entry in entries if entry.filename.lower().endswith(".model")]
        if len(models) != 1:
            raise InputError(f"{len(models)} models in it; there must be one")
        promised, unit_mm = _promised_by_model(archive.read(models[0]))
    vertices, faces = _by_trimesh(data, "3mf", promised)
    return unit_mm * vertices, faces


def _promised_by_model(model: bytes) -> tuple[int, float]:
    """Number of triangles that a 3MF model places, and its unit in mm.

    Refused is also what trimesh would leave out, or place without end.
    """
    from lxml import etree

    triangles: dict[str, int] = {}
    parts: dict[str, list[str]] = {}
    waiting: list[str] = []
    elements = etree.iterparse(io.BytesIO(model), tag=("{*}object", "{*}item"), resolve_entities=False)
    for _, element in elements:
        key = element.get("id", "")
        if element.tag.endswith("item"):
            waiting.append(element.get("objectid", ""))
        elif key in parts:
            raise InputError(f"object {key[:40]!r} stands twice")
        else:
            triangles[key] = sum(1 for _ in element.iter("{*}triangle"))
            parts[key] = [part.get("objectid", "") for part in element.iter("{*}component")]
        element.clear()
    if elements.root.getroottree().docinfo.doctype:
        raise InputError("its model has a document type, which may hold entities")
    unit = elements.root.get("unit", "millimeter")
    if unit not in UNITS_MM:
        raise InputError(f"unit {unit[:40]!r}; known are {', '.join(UNITS_MM)}")
    placed = promised = 0
    while waiting:
        key, placed = waiting.pop(), placed + 1
        if key not in parts:
            raise InputError(f"object {key[:40]!r} is placed, and does not exist")
        if placed > MOST_PLACED:
            raise InputError(f"more than {MOST_PLACED} objects placed, or some within themselves")
        promised += triangles[key]
        waiting += parts[key]
    if not promised:
        raise InputError("no triangle in it")
    return promised, UNITS_MM[unit]


def _obj_triangles(data: bytes) -> Triangles:
    """Vertices and faces; materials, textures, normals and groups say nothing of the shape."""
    values, faces = array("d"), array("q")
    for line in data.splitlines():
        words = line.split()
        if words[:1] == [b"v"]:
            values.extend(float(word) for word in words[1:4])
        elif words[:1] == [b"f"]:
            known = len(values) // 3
            corners = [int(word.partition(b"/")[0]) for word in words[1:]]
            if len(corners) < 3 or not all(0 < abs(corner) <= known for corner in corners):
                said = line[:60].decode("ascii", "replace")
                raise InputError(f"{said!r} is no face, with {known} vertices before it")
            first, *others = (corner - 1 if corner > 0 else known + corner for corner in corners)
            for second, third in pairwise(others):
                faces.extend((first, second, third))
            _refuse_count(len(faces) // 3)
    return np.array(values, float).reshape(-1, 3), np.array(faces, np.int64).reshape(-1, 3)

"""Mesh files of any origin, read without trusting their headers.

trimesh reads STL, PLY and 3MF. The size that a file declares is checked against limits before, and against
the result afterwards, because trimesh silently accepts truncated text files. OBJ is read by this module:
trimesh resolves negative indices from the end of the file instead of from their own line. Other files that a
mesh file names are never opened. Lengths are in mm in formats without a unit (all except 3MF).
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

# trimesh prints tracebacks for damaged files; the message of read_mesh replaces them.
logging.getLogger("trimesh").addHandler(logging.NullHandler())

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
    """Triangles of a mesh file.

    Attributes
    ----------
    vertices_mm
        Vertices in mm, shape (n, 3).
    faces
        Vertex indices of each triangle, anticlockwise as seen from outside, shape (m, 3).
    """

    vertices_mm: NDArray[np.float64]
    faces: NDArray[np.int64]


def read_mesh(path: str | os.PathLike[str]) -> TriangleMesh:
    """Read a mesh file.

    Parameters
    ----------
    path
        A ``.stl`` (binary or text), ``.ply`` (text or binary), ``.obj`` or ``.3mf`` file of at most 1 GB (256
        MB for OBJ and 3MF) and 20 million triangles. Polygons are divided into triangles.

    Returns
    -------
    TriangleMesh
        Vertices in mm and faces.

    Raises
    ------
    InputError
        If the suffix is unknown, or the file is not a regular file, is too large, truncated or malformed, or
        holds no triangle. The message names the file.

    Examples
    --------
    >>> from lensdesign import load_design, read_mesh, write_mesh
    >>> written = write_mesh(load_design("designs/paper_singlet.toml"), "lens.ply", chord_error_um=5.0)
    >>> mesh = read_mesh("lens.ply")
    >>> len(mesh.faces) == written.triangles, mesh.vertices_mm.shape[1]
    (True, 3)
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
    except Exception as error:  # trimesh raises exceptions of many types for damaged files
        message = f"not a valid {suffix[1:].upper()} file: {str(error)[:200]}"
        raise InputError(f"cannot read {path}: {message}") from error


def _checked(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> TriangleMesh:
    if not len(faces):
        raise InputError("the file holds no triangle")
    if not np.all(np.isfinite(vertices)):
        raise InputError("a coordinate is not a finite number")
    largest = float(np.max(np.abs(vertices)))
    # Largest coordinate; beyond it, squares of coordinates lose their precision.
    max_coordinate_mm = 1e6
    if largest > max_coordinate_mm:
        raise InputError(f"a coordinate of {largest:.3g} mm; allowed: at most {max_coordinate_mm:g} mm")
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise InputError(f"a triangle has a vertex that does not exist; there are {len(vertices)}")
    return TriangleMesh(vertices, faces)


def _check_count(triangles: int) -> None:
    max_triangles = 20_000_000
    if triangles > max_triangles:
        raise InputError(f"{triangles} triangles; allowed: at most {max_triangles}")


def _stl_triangles(data: bytes) -> Triangles:
    count = int.from_bytes(data[80:84], "little")
    if len(data) != 84 + 50 * count:
        if data[:512].lstrip()[:5].lower() != b"solid":
            raise InputError(f"{len(data)} bytes; the {count} triangles of its header need {84 + 50 * count}")
        count = len(re.findall(rb"^\s*facet\b", data, re.MULTILINE | re.IGNORECASE))
    return _by_trimesh(data, "stl", count)


def _ply_triangles(data: bytes) -> Triangles:
    max_header_bytes = 65536
    if data.find(b"end_header", 0, max_header_bytes) < 0:
        raise InputError(f"not a PLY file: end_header must occur within {max_header_bytes} bytes")
    found = re.findall(rb"^element (\w+) (\d{1,18})\s", data[:max_header_bytes], re.MULTILINE)
    rows = {name: int(count) for name, count in found}
    most = max(rows.values(), default=0)
    if most > len(data):
        raise InputError(f"the header declares {most} rows, but the file has only {len(data)} bytes")
    return _by_trimesh(data, "ply", rows.get(b"face", 0), skip_materials=True)


def _by_trimesh(data: bytes, kind: str, declared: int, **options: bool) -> Triangles:
    """Return the triangles of a file; raise an error if there are fewer than declared."""
    import trimesh

    _check_count(declared)
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        # Older NumPy releases only warn about an invalid number and ignore the remaining text.
        warnings.filterwarnings("error", "string or file could not be read", DeprecationWarning)
        mesh = trimesh.load_mesh(io.BytesIO(data), file_type=kind, process=False, **options)
    if len(mesh.faces) < declared:
        raise InputError(f"{declared} faces declared, {len(mesh.faces)} found; is the file truncated?")
    return np.array(mesh.vertices, float), np.array(mesh.faces, np.int64)


def _three_mf_triangles(data: bytes) -> Triangles:
    max_entries = 1000
    if data.count(b"PK\x01\x02") > max_entries:
        raise InputError(f"the archive has more than {max_entries} entries")
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        entries = archive.infolist()
        for entry in entries:
            folders = entry.filename.replace("\\", "/").split("/")
            if not folders[0] or ".." in folders or ":" in folders[0]:
                raise InputError(f"the archive has the path {entry.filename[:60]!r} outside of itself")
        unpacked = sum(entry.file_size for entry in entries)
        if unpacked > TABLE_BYTES:
            raise InputError(f"the unpacked archive has {unpacked} bytes; allowed: at most {TABLE_BYTES}")
        models = [entry for entry in entries if entry.filename.lower().endswith(".model")]
        if len(models) != 1:
            raise InputError(f"the archive holds {len(models)} models; it must hold exactly one")
        declared, unit_mm = _declared_by_model(archive.read(models[0]))
    vertices, faces = _by_trimesh(data, "3mf", declared)
    return unit_mm * vertices, faces


def _declared_by_model(model: bytes) -> tuple[int, float]:
    """Return the number of triangles that a 3MF model places, and its unit in mm.

    Raise an error also for contents that trimesh would ignore or place endlessly.
    """
    from lxml import etree

    triangles: dict[str, int] = {}
    components: dict[str, list[str]] = {}
    pending: list[str] = []
    elements = etree.iterparse(io.BytesIO(model), tag=("{*}object", "{*}item"), resolve_entities=False)
    for _, element in elements:
        key = element.get("id", "")
        if element.tag.endswith("item"):
            pending.append(element.get("objectid", ""))
        elif key in components:
            raise InputError(f"object {key[:40]!r} is defined twice")
        else:
            triangles[key] = sum(1 for _ in element.iter("{*}triangle"))
            components[key] = [one.get("objectid", "") for one in element.iter("{*}component")]
        element.clear()
    if elements.root.getroottree().docinfo.doctype:
        raise InputError("the model has a document type (DOCTYPE), which is not allowed")
    unit = elements.root.get("unit", "millimeter")
    if unit not in UNITS_MM:
        raise InputError(f"unit {unit[:40]!r}; allowed: {', '.join(UNITS_MM)}")
    placed = declared = 0
    # Largest number of objects that a 3MF file places; nested components could place billions.
    max_placed_objects = 10_000
    while pending:
        key, placed = pending.pop(), placed + 1
        if key not in components:
            raise InputError(f"object {key[:40]!r} is placed, but not defined")
        if placed > max_placed_objects:
            raise InputError(f"more than {max_placed_objects} objects placed, or an object contains itself")
        declared += triangles[key]
        pending += components[key]
    if not declared:
        raise InputError("the file holds no triangle")
    return declared, UNITS_MM[unit]


def _obj_triangles(data: bytes) -> Triangles:
    """Return vertices and faces; materials, textures, normals and groups do not affect the shape."""
    values, faces = array("d"), array("q")
    for line in data.splitlines():
        words = line.split()
        if words[:1] == [b"v"]:
            values.extend(float(word) for word in words[1:4])
        elif words[:1] == [b"f"]:
            known = len(values) // 3
            corners = [int(word.partition(b"/")[0]) for word in words[1:]]
            if len(corners) < 3 or not all(0 < abs(corner) <= known for corner in corners):
                message = line[:60].decode("ascii", "replace")
                raise InputError(f"{message!r} is not a valid face; {known} vertices precede it")
            first, *others = (corner - 1 if corner > 0 else known + corner for corner in corners)
            for second, third in pairwise(others):
                faces.extend((first, second, third))
            _check_count(len(faces) // 3)
    return np.array(values, float).reshape(-1, 3), np.array(faces, np.int64).reshape(-1, 3)
